"""Problems made of public parts: the same as from a file, and refused in the same words."""

from dataclasses import replace
from functools import partial
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


BOX = shapely.box(10, 10, 12, 12)
GRID = partial(
    OccupancyGrid,
    occupied=np.zeros((2, 2), dtype=bool),
    unknown=np.zeros((2, 2), dtype=bool),
    resolution_m=1.0,
    origin_m=(0.0, 0.0),
)


def drawn(truth):
    channel = ChannelSetup(truth=truth, measurements=SampledMeasurements(5))
    return draw_initial_data(small(channel=channel), 0)


def arrays(x_m, y_m, power_dbm, **more):
    return drawn(ArrayTruth(x_m=x_m, y_m=y_m, power_dbm=power_dbm, **more))


REFUSED = {
    "robots: none": lambda: small(robots=()),
    "robots: text": lambda: small(robots="robot"),
    "stations: table": lambda: small(stations={"position_m": (1, 1)}),
    "workspace: bounds": lambda: small(workspace=(0, 0, 1, 1)),
    "planner: number": lambda: small(planner=3),
    "workspace: order": lambda: small(workspace=Workspace((0, 0, -40, 30))),
    "start: outside": lambda: small(robots=replace(ROBOT, start_m=(50, 5))),
    "goal: none": lambda: small(robots=replace(ROBOT, goal_m=None)),
    "constraints: default": lambda: small(constraints=Constraints()),
    "objective: text": lambda: small(objective=["tracking"]),
    "objective: none": lambda: small(objective=[]),
    "truth: none": lambda: small(channel=ChannelSetup(measurements=SampledMeasurements(5))),
    "truth: cells": lambda: drawn(FunctionTruth(power_dbm=power_dbm, cell_m=float("nan"))),
    "truth: floor": lambda: drawn(FunctionTruth(power_dbm=power_dbm, floor_dbm=-60.0)),
    "truth: positions": lambda: drawn(FunctionTruth(power_dbm=lambda places: places)),
    "truth: text": lambda: drawn(FunctionTruth(power_dbm=lambda places: "loud")),
    "truth: NaN": lambda: drawn(FunctionTruth(power_dbm=lambda xy: np.full(len(xy), np.nan))),
    "truth: two": lambda: drawn(FunctionTruth(power_dbm=lambda xy: np.full((2, len(xy)), -60.0))),
    "array: shape": lambda: arrays([0, 1], [0, 1, 2], np.zeros((2, 2))),
    "array: axis": lambda: arrays([1, 0], [0, 1], np.full((2, 2), -60.0)),
    "array: inf": lambda: arrays([0, 1], [0, 1], np.full((2, 2), np.inf)),
    "array: floor": lambda: arrays([0, 1], [0, 1], np.zeros((2, 2)), floor_dbm=float("nan")),
    "array: text": lambda: arrays("a", [0, 1], np.zeros((2, 2))),
    "speed": lambda: replace(ROBOT, speed_max_m_s=-1.0),
    "start: text": lambda: replace(ROBOT, start_m="ab"),
    "start: three": lambda: replace(ROBOT, start_m=(1, 1, 1)),
    "start: letters": lambda: replace(ROBOT, start_m=("a", 1.0)),
    "dynamics: text": lambda: replace(ROBOT, dynamics="double_integrator"),
    "dynamics: class": lambda: replace(ROBOT, dynamics=DoubleIntegrator),
    "fit": lambda: ChannelSetup(fit_method="guess"),
    "spacing": lambda: ChannelSetup(measure_spacing_m=float("nan")),
    "channel: function": lambda: ChannelSetup(truth=power_dbm),
    "measurements: table": lambda: ChannelSetup(measurements={"x_m": [1]}),
    "threshold": lambda: replace(STATION, threshold_dbm=float("inf")),
    "p_min": lambda: Constraints(p_min=float("nan")),
    "rule: outage": lambda: Constraints(p_min=0.5, rule=ConnectivityRule("outage")),
    "rule: text": lambda: Constraints(rule="outage"),
    "terms": lambda: TermsObjective(()),
    "horizon": lambda: PlannerSettings(step_s=1.0, horizon=0),
    "planner: name": lambda: PlannerSettings(step_s=1.0, name="best"),
    "cost-to-go": lambda: ReachObjective(cost_to_go="zero"),
    "workspace: polygons": lambda: Workspace((0, 0, 1, 1), [BOX]),
    "obstacle: corners": lambda: Obstacle("house", [(0, 0), (1, 0), (1, 1)]),
    "obstacle: name": lambda: Obstacle(None, BOX),
    "obstacle: bow": lambda: Obstacle("bow", shapely.Polygon([(2, 2), (3, 3), (3, 2), (2, 3)])),
    "obstacle: empty": lambda: Obstacle("none", shapely.Polygon()),
    "obstacle: times": lambda: Obstacle("late", BOX, 3.0, 2.0),
    "source: number": lambda: obstacles_from(3),
    "source: none": lambda: obstacles_from(None),
    "source: text": lambda: obstacles_from("POLYGON"),
    "source: point": lambda: obstacles_from(shapely.Point(1, 1)),
    "source: 3-D": lambda: obstacles_from([[1.0, 2.0, 3.0]]),
    "source: cells": lambda: obstacles_from(np.ones((4, 5), dtype=np.bool_)),
    "source: two columns": lambda: obstacles_from(np.ones((3, 2), dtype=np.bool_)),
    "grid: occupied": lambda: GRID(occupied=[[1, 0], [0, 0]]),
    "grid: unknown": lambda: GRID(unknown=np.zeros((3, 3), dtype=np.bool_)),
    "grid: resolution": lambda: GRID(resolution_m=-1.0),
    "grid: origin": lambda: GRID(origin_m=None),
    "count: negative": lambda: SampledMeasurements(-3),
    "count: fraction": lambda: SampledMeasurements(2.5),
    "count: text": lambda: SampledMeasurements("many"),
    "count: true": lambda: SampledMeasurements(True),
    "compare: name": lambda: compare("open_field", [1]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_python(case) -> None:
    """The error has the key of the problem file, the value, and usually the remedy."""
    with refused():
        REFUSED[case]()


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


def test_obstacles_of_any_source(tmp_path) -> None:
    """The same area from every kind of source."""
    house = shapely.box(10, 10, 14, 13)
    file = tmp_path / "house.wkt"
    file.write_text(house.wkt)
    grid = planopt.problems.OccupancyGrid(
        occupied=np.pad(np.ones((3, 4), dtype=bool), ((10, 5), (10, 6))),
        unknown=np.zeros((18, 20), dtype=bool),
        resolution_m=1.0,
        origin_m=(0.0, 0.0),
    )
    series = SimpleNamespace(geometry=[house])
    frame = NamedGeometries([house], ["town hall"])
    corners = shapely.get_coordinates(house.exterior)
    for source in (house, [house], series, corners, corners[:-1].tolist(), grid, file, str(file)):
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


def test_a_connection_is_true_or_false() -> None:
    """From the first call on, which takes none in."""
    truth = FunctionTruth(power_dbm=power_dbm)
    channel = ChannelSetup(truth=truth, measurements=SampledMeasurements(20))
    planner = planopt.Planner(small(channel=channel), horizon=2)
    with refused():
        planner.step((4.0, 4.0), connected="yes")


def test_ground_truth_of_arrays_and_functions() -> None:
    """Every cell has the power of its centre; the first axis counts stations."""
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
    """A problem with a truth from Python is read back without it, and is still verified."""
    truth = FunctionTruth(power_dbm=power_dbm)
    problem = small(channel=ChannelSetup(truth=truth, measurements=SampledMeasurements(5)))
    again = problem_from_dict(problem_to_dict(problem))
    assert again == replace(problem, channel=ChannelSetup())


def test_a_run_in_a_truth_of_ones_own(tmp_path) -> None:
    """It is driven, saved and checked from its files alone, like one of a problem file."""
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
