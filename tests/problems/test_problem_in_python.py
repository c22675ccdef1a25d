"""Problems made of public parts: the same as from a file, and refused in the same words."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from refusals import refused

import planopt
from planopt import (
    BaseStation,
    ChannelSetup,
    ConnectivityRule,
    Constraints,
    InputError,
    Obstacle,
    PlannerSettings,
    Problem,
    Robot,
    Workspace,
    compare,
    load,
    obstacles_from,
    solve,
)
from planopt.channel import true_power_dbm
from planopt.objectives import LearningTerm, ReachObjective, TermsObjective, TrackingTerm
from planopt.planning.initial_data import draw_initial_data
from planopt.problems import (
    ArrayTruth,
    DoubleIntegrator,
    FunctionTruth,
    ModelTruth,
    OccupancyGrid,
    SampledMeasurements,
    problem_from_dict,
    problem_to_dict,
)

STATION = BaseStation(position_m=(20, 15), transmit_power_dbm=0.0, threshold_dbm=-70.0)

ROBOT = Robot(start_m=[5, 5], goal_m=np.array([35.0, 25.0]), speed_max_m_s=2.0)


def power_dbm(places_m: np.ndarray) -> np.ndarray:
    """Falls with the distance from the station, and northward."""
    away = np.hypot(places_m[..., 0] - 20.0, places_m[..., 1] - 15.0)
    return -30.0 - 20.0 * np.log10(np.hypot(away, 1.0)) - 0.1 * places_m[..., 1]


def small(**changes) -> Problem:
    """A robot, a station and a rectangle, all else by default."""
    given = {
        "robots": ROBOT,
        "stations": STATION,
        "workspace": Workspace((0, 0, 40, 30)),
        "constraints": Constraints(p_min=0.8),
        "planner": PlannerSettings(step_s=1.0, horizon=4),
        **changes,
    }
    return Problem(**given)


def test_the_same_by_file_and_by_python() -> None:
    """Its parts written out in Python are the problem of the file, and its plan is the same."""
    from_file = load("open_field")
    truth = from_file.channel.truth
    assert isinstance(truth, ModelTruth)
    robot, station = from_file.robots[0], from_file.stations[0]
    in_python = Problem(
        name="open_field",
        description=from_file.description,
        robots=[
            Robot(
                name=robot.name,
                start_m=list(robot.start_m),
                goal_m=list(robot.goal_m),
                speed_max_m_s=robot.speed_max_m_s,
            )
        ],
        stations=[
            BaseStation(
                name=station.name,
                position_m=np.array(station.position_m),
                height_m=np.float64(station.height_m),
                transmit_power_dbm=station.transmit_power_dbm,
                threshold_dbm=station.threshold_dbm,
            )
        ],
        workspace=Workspace(
            from_file.workspace.bounds_m,
            obstacles_from({each.name: each for each in from_file.workspace.obstacles}.values()),
        ),
        channel=ChannelSetup(
            truth=replace(truth, cell_m=np.float64(truth.cell_m)),
            measurements=SampledMeasurements(from_file.channel.measurements.count),
            measure_spacing_m=from_file.channel.measure_spacing_m,
        ),
        objective=from_file.reach,
        constraints=Constraints(
            p_min=from_file.constraints.p_min, clearance_m=from_file.constraints.clearance_m
        ),
        planner=PlannerSettings(
            step_s=from_file.planner.step_s,
            horizon=from_file.planner.horizon,
            max_steps=from_file.planner.max_steps,
        ),
        report=from_file.report,
    )
    assert replace(from_file, file=None) == in_python
    one, other = solve(from_file, horizon=3).plan, solve(in_python, horizon=3).plan
    assert np.array_equal(one.positions_m, other.positions_m)
    assert one.objective == other.objective


def test_defaults_are_those_of_files() -> None:
    """The least that a file must say, said by both."""
    tables = {
        "problem": {"schema": 1, "name": "problem"},
        "world": {"bounds_m": [0, 0, 40, 30]},
        "channel": {"measurements": {"count": 0}},
        "robots": [{"start_m": [5, 5], "goal_m": [35, 25], "speed_max_m_s": 2.0}],
        "stations": [{"position_m": [20, 15], "transmit_power_dbm": 0.0, "threshold_dbm": -70.0}],
        "constraints": {"p_min": 0.8},
        "planner": {"step_s": 1.0},
    }
    assert problem_from_dict(tables) == small(planner=PlannerSettings(step_s=1.0))


@pytest.mark.parametrize(
    "changes",
    [
        {"robots": ()},
        {"robots": "robot"},
        {"stations": {"position_m": (1, 1)}},
        {"workspace": (0, 0, 1, 1)},
        {"planner": 3},
        {"workspace": Workspace((0, 0, -40, 30))},
        {"robots": replace(ROBOT, start_m=(50, 5))},
        {"robots": replace(ROBOT, goal_m=None)},
        {"constraints": Constraints()},
        {"objective": ["tracking"]},
        {"objective": []},
        {"channel": ChannelSetup(measurements=SampledMeasurements(5))},
        {"channel": ChannelSetup(truth=FunctionTruth(power_dbm=power_dbm, cell_m=float("nan")))},
        {"channel": ChannelSetup(truth=FunctionTruth(power_dbm=power_dbm, floor_dbm=-60.0))},
    ],
)
def test_a_fault_is_named_where_the_problem_is_made(changes) -> None:
    """The key is that of the problem file, and no dependency speaks."""
    with refused():
        small(**changes)


@pytest.mark.parametrize(
    "make",
    [
        lambda: replace(ROBOT, speed_max_m_s=-1.0),
        lambda: replace(ROBOT, start_m="ab"),
        lambda: replace(ROBOT, start_m=(1, 1, 1)),
        lambda: replace(ROBOT, start_m=("a", 1.0)),
        lambda: ChannelSetup(fit_method="guess"),
        lambda: ChannelSetup(measure_spacing_m=float("nan")),
        lambda: replace(STATION, threshold_dbm=float("inf")),
        lambda: Constraints(p_min=float("nan")),
        lambda: Constraints(p_min=0.5, rule=ConnectivityRule("outage")),
        lambda: TermsObjective(()),
        lambda: PlannerSettings(step_s=1.0, horizon=0),
        lambda: PlannerSettings(step_s=1.0, name="best"),
        lambda: ReachObjective(cost_to_go="zero"),
    ],
)
def test_a_part_validates_itself(make) -> None:
    """The error has the key of the problem file, the value and the remedy."""
    with refused() as caught:
        make()
    assert caught.value.remedy


def test_parts_of_a_wrong_kind() -> None:
    """Each part refuses what it cannot be made of."""
    for make in (
        lambda: Workspace((0, 0, 1, 1), [shapely.box(0, 0, 1, 1)]),
        lambda: Obstacle("house", [(0, 0), (1, 0), (1, 1)]),
        lambda: ChannelSetup(truth=power_dbm),
        lambda: ChannelSetup(measurements={"x_m": [1]}),
        lambda: Constraints(rule="outage"),
    ):
        with refused():
            make()


def test_terms_are_an_objective() -> None:
    """One term or several; the first says what the task is."""
    robots = [replace(ROBOT, name=name, goal_m=None) for name in ("a", "b")]
    learning = LearningTerm()
    assert small(robots=robots, objective=learning).task == "learn"
    assert small(robots=robots, objective=[learning]).terms == (learning,)
    tracking = TrackingTerm(noise_curvature=0.01, noise_floor_m2=0.1, sweet_spot_m=1.0)
    with refused():
        small(robots=robots, objective=[tracking])


class NamedGeometries(dict):
    """What of a GeoDataFrame is used: its geometries and a column of names."""

    def __init__(self, geometries: list[shapely.Geometry], names: list[str]) -> None:
        super().__init__(name=names, geometry=geometries)
        self.geometry, self.columns = geometries, ["name", "geometry"]


def test_obstacles_of_any_source() -> None:
    """The same area by every way of saying it."""
    house = shapely.box(10, 10, 14, 13)
    grid = planopt.problems.OccupancyGrid(
        occupied=np.pad(np.ones((3, 4), dtype=bool), ((10, 5), (10, 6))),
        unknown=np.zeros((18, 20), dtype=bool),
        resolution_m=1.0,
        origin_m=(0.0, 0.0),
    )
    series = SimpleNamespace(geometry=[house])
    frame = NamedGeometries([house], ["town hall"])
    corners = shapely.get_coordinates(house.exterior)
    for source in (house, [house], series, corners, corners[:-1].tolist(), grid):
        (obstacle,) = obstacles_from(source, "house")
        assert obstacle.name == "house"
        assert obstacle.polygon.equals(house)
    assert obstacles_from(frame)[0].name == "town hall"
    two = shapely.MultiPolygon([house, shapely.box(20, 0, 21, 1)])
    assert [each.name for each in obstacles_from([two, Obstacle("own", house)])] == [
        "obstacle 1 part 1",
        "obstacle 1 part 2",
        "own",
    ]
    assert obstacles_from([]) == ()


@pytest.mark.parametrize("source", [3, None, "POLYGON", shapely.Point(1, 1), [[1.0, 2.0, 3.0]]])
def test_no_obstacle(source) -> None:
    """What is no area is refused."""
    with pytest.raises(InputError):
        obstacles_from(source)


def test_a_grid_without_a_place() -> None:
    """Cells of true and false are no corners."""
    for shape in ((3, 2), (4, 5)):
        with refused():
            obstacles_from(np.ones(shape, dtype=np.bool_))


@pytest.mark.parametrize(
    "parts",
    [
        {"occupied": [[1, 0], [0, 0]]},
        {"unknown": np.zeros((3, 3), dtype=np.bool_)},
        {"resolution_m": -1.0},
        {"origin_m": None},
    ],
)
def test_no_grid(parts) -> None:
    """Where it is made."""
    none = np.zeros((2, 2), dtype=np.bool_)
    given = {"occupied": none, "unknown": none, "resolution_m": 1.0, "origin_m": (0.0, 0.0)}
    with refused():
        OccupancyGrid(**{**given, **parts})


@pytest.mark.parametrize("count", [-3, 2.5, "many", True])
def test_no_number_of_measurements(count) -> None:
    """Where it is given."""
    with refused():
        SampledMeasurements(count)


@pytest.mark.parametrize(
    ("name", "polygon", "times"),
    [
        (None, shapely.box(10, 10, 12, 12), ()),
        ("bow", shapely.Polygon([(20, 20), (30, 30), (30, 20), (20, 30)]), ()),
        ("none", shapely.Polygon(), ()),
        ("late", shapely.box(10, 10, 12, 12), (3.0, 2.0)),
    ],
)
def test_obstacle_checked_where_made(name, polygon, times) -> None:
    """An obstacle is checked where it is made."""
    with refused():
        Obstacle(name, polygon, *times)


def test_a_connection_is_true_or_false() -> None:
    """From the first call on, which takes none in."""
    truth = FunctionTruth(power_dbm=power_dbm)
    channel = ChannelSetup(truth=truth, measurements=SampledMeasurements(20))
    planner = planopt.Planner(small(channel=channel), horizon=2)
    with refused():
        planner.step((4.0, 4.0), connected="yes")


def test_ground_truth_of_arrays_and_functions() -> None:
    """Every cell has the power of its centre, whichever way it was given."""
    by_function = FunctionTruth(power_dbm=power_dbm, cell_m=0.5, floor_dbm=-90.0)
    x, y = np.arange(0.25, 40.0, 0.5), np.arange(0.25, 30.0, 0.5)
    centres = np.stack(np.meshgrid(x, y), axis=-1)
    by_arrays = ArrayTruth(x_m=x, y_m=y, power_dbm=power_dbm(centres), floor_dbm=-90.0)
    places = np.random.default_rng(1).uniform((0, 0), (40, 30), (50, 2))
    nearest = np.floor(places / 0.5) * 0.5 + 0.25
    for truth in (by_function, by_arrays):
        channel = ChannelSetup(truth=truth, measurements=SampledMeasurements(40))
        given = draw_initial_data(small(channel=channel), 3)
        assert true_power_dbm(given.truths[0], places) == pytest.approx(power_dbm(nearest))
        assert len(given.measurements[0]) == 40


@pytest.mark.parametrize(
    "truth",
    [
        FunctionTruth(power_dbm=lambda places: places),
        FunctionTruth(power_dbm=lambda places: "loud"),
        FunctionTruth(power_dbm=lambda places: np.full(len(places), np.nan)),
        FunctionTruth(power_dbm=lambda places: np.full((2, len(places)), -60.0)),
        ArrayTruth(x_m=[0, 1], y_m=[0, 1, 2], power_dbm=np.zeros((2, 2))),
        ArrayTruth(x_m=[1, 0], y_m=[0, 1], power_dbm=np.full((2, 2), -60.0)),
        ArrayTruth(x_m=[0, 1], y_m=[0, 1], power_dbm=np.full((2, 2), np.inf)),
        ArrayTruth(x_m=[0, 1], y_m=[0, 1], power_dbm=np.zeros((2, 2)), floor_dbm=float("nan")),
        ArrayTruth(x_m="a", y_m=[0, 1], power_dbm=np.zeros((2, 2))),
    ],
)
def test_ground_truth_that_is_none(truth) -> None:
    """Whatever is wrong with it, the error is ours."""
    channel = ChannelSetup(truth=truth, measurements=SampledMeasurements(5))
    with pytest.raises(InputError):
        draw_initial_data(small(channel=channel), 0)


def test_ground_truth_of_several_stations() -> None:
    """The first axis counts them."""
    truth = FunctionTruth(
        power_dbm=lambda places: np.stack([power_dbm(places), power_dbm(places) - 7.0])
    )
    channel = ChannelSetup(truth=truth, measurements=SampledMeasurements(10))
    given = draw_initial_data(
        small(channel=channel, stations=[STATION, replace(STATION, name="b")]), 0
    )
    first, second = (each.power_dbm for each in given.measurements)
    assert first - second == pytest.approx(np.full(10, 7.0))


def test_own_measurements() -> None:
    """They take the place of those that the problem would have taken."""
    truth = FunctionTruth(power_dbm=power_dbm, cell_m=0.5)
    sampled = small(channel=ChannelSetup(truth=truth, measurements=SampledMeasurements(40)))
    taken = draw_initial_data(sampled, 5).measurements[0]
    table = {
        "x_m": taken.positions_m[:, 0],
        "y_m": taken.positions_m[:, 1],
        "power_dbm": taken.power_dbm,
    }
    expected = solve(sampled, seed=5).plan
    for given in (taken, table, [taken]):
        plan = solve(small(), measurements=given).plan
        assert np.array_equal(plan.positions_m, expected.positions_m)
    with refused():
        solve(small())
    with refused():
        solve(small(), measurements=[taken, taken])


def test_saved_without_what_no_file_can_hold() -> None:
    """A problem with a truth from Python is read back without it, and is judged all the same."""
    truth = FunctionTruth(power_dbm=power_dbm)
    problem = small(channel=ChannelSetup(truth=truth, measurements=SampledMeasurements(5)))
    again = problem_from_dict(problem_to_dict(problem))
    assert again == replace(problem, channel=ChannelSetup())


def test_a_run_in_a_truth_of_ones_own(tmp_path) -> None:
    """It is driven, saved and judged from its files alone, as one of a problem file is."""
    truth = FunctionTruth(power_dbm=power_dbm, cell_m=0.5)
    problem = small(
        channel=ChannelSetup(truth=truth, measurements=SampledMeasurements(40)),
        planner=PlannerSettings(step_s=1.0, horizon=3, max_steps=4),
    )
    run = planopt.simulate(problem, seed=2)
    run.save(tmp_path / "run")
    log = draw_initial_data(problem, 2).measurements[0]
    again = planopt.simulate(
        replace(problem, channel=ChannelSetup(truth=truth)), seed=2, measurements=log
    )
    again.save(tmp_path / "again")
    for plan, other in zip(run.plans[0], again.plans[0], strict=True):
        assert np.array_equal(plan.positions_m, other.positions_m)
    for name in ("run", "again"):
        assessed = planopt.check(tmp_path / name)
        assert assessed.verdict is planopt.Verdict.VERIFIED
        assert any("has no ground truth" in remark for remark in assessed.remarks)
        assert not any("cannot be drawn" in remark for remark in assessed.remarks)


def test_remarks_of_a_library_problem_with_another_truth(tmp_path) -> None:
    """The library's truth and measurements are not said to be missing key by key."""
    field = planopt.load("open_field")
    truth = FunctionTruth(power_dbm=power_dbm)
    channel = ChannelSetup(truth=truth, measurements=SampledMeasurements(40))
    planopt.solve(replace(field, channel=channel), horizon=2).save(tmp_path)
    remarks = planopt.check(tmp_path).remarks
    assert sum("the library's open_field has" in one for one in remarks) == 1
    by_key = [one for one in remarks if "in the library's" in one]
    assert not any("truth" in one or "count" in one for one in by_key)


@pytest.mark.parametrize("dynamics", ["double_integrator", DoubleIntegrator])
def test_dynamics_are_an_object(dynamics: object) -> None:
    """The problem file's word, or the class itself, is told what to give instead."""
    with refused():
        Robot(start_m=(0.0, 0.0), speed_max_m_s=1.0, dynamics=dynamics)  # type: ignore[arg-type]


def test_what_is_compared_is_a_problem() -> None:
    """A name is not loaded by itself."""
    with refused():
        compare("open_field", [1])  # type: ignore[arg-type]
