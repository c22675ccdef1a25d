"""A loop of one's own with Planner: the run that simulate makes, step by step, and its errors."""

import pickle
import tracemalloc
from dataclasses import replace
from threading import Thread

import numpy as np
import pytest
from scipy.spatial import cKDTree

import planopt
from planopt import InputError, Measurements, Planner, Problem, Verdict, load, simulate
from planopt.channel import measure
from planopt.planning.initial_data import prepare, team_seeds
from planopt.planning.loop.metrics import true_serving_dbm
from planopt.planning.stepping import watch_target
from planopt.problems import Unicycle
from planopt.targets.information_filter import sense

SEED = 4


def shortened(name: str, steps: int, **changes) -> Problem:
    """A library problem that ends after some steps."""
    problem = load(name)
    planner = replace(problem.planner, horizon=4, max_steps=steps)
    return replace(problem, planner=planner, **changes)


def plans_of(run) -> list[list[planopt.Plan]]:
    """The plans of a run, of each robot."""
    return [list(made) for made in run.plans]


def driven(problem: Problem, steps: int) -> list[list[planopt.Plan]]:
    """Plans of a loop written by hand, of each robot: drive, measure, see, plan again."""
    truths = prepare(problem, SEED).truths
    threshold = problem.stations[0].threshold_dbm
    generator = team_seeds(problem, SEED).target
    watch = watch_target(problem, generator)
    planner = Planner(problem, seed=SEED)
    made = [planner.step_all([robot.start_state for robot in problem.robots])]
    for step in range(1, steps):
        states = [plan.next_state for plan in made[-1]]
        here = np.array([state[:2] for state in states])
        seen = None if watch is None else sense(watch.sensor, here, watch.true_m[step], generator)
        made.append(
            planner.step_all(
                states,
                [[measure(truth, place[None]) for truth in truths] for place in here],
                connected=true_serving_dbm(problem, truths, here) >= threshold,
                target_m=seen,
            )
        )
    return [list(plans) for plans in zip(*made, strict=True)]


@pytest.mark.parametrize(
    ("name", "steps"),
    [
        ("open_field", 8),
        ("harbour_reach", 4),
        ("two_station_courier", 4),
        ("outdoor_track", 4),
        ("outdoor_map", 4),
        ("harbour_track", 3),
        ("connect_street", 4),
    ],
)
def test_a_loop_by_hand_is_the_simulation(name: str, steps: int) -> None:
    """Goals, teams with a target, maps, dynamics and several stations: every plan is the same."""
    problem = shortened(name, steps)
    expected = plans_of(simulate(problem, seed=SEED))
    count = len(expected[0])
    assert count > 1
    for own, reference in zip(driven(problem, count), expected, strict=True):
        for plan, other in zip(own, reference, strict=True):
            assert np.array_equal(plan.positions_m, other.positions_m)
            assert plan.objective == other.objective
            assert plan.verdict is other.verdict
            assert plan.rung is other.rung


@pytest.fixture(scope="module")
def log() -> Measurements:
    return prepare(load("open_field"), 0).belief.posterior.measurements


def test_own_measurements_make_the_belief(log: Measurements) -> None:
    """First those given, then those of each step that are far enough from earlier ones."""
    problem = shortened("open_field", 10)
    planner = Planner(problem, measurements=log)
    plan = planner.step(problem.robots[0].start_m)
    assert np.array_equal(planner.beliefs[0].posterior.measurements.power_dbm, log.power_dbm)
    spacing = problem.channel.measure_spacing_m
    here = plan.next_position_m
    places = np.array([here, here + (0.1 * spacing, 0.0), here + (2.0 * spacing, 0.0)])
    planner.step(here, {"x_m": places[:, 0], "y_m": places[:, 1], "power_dbm": [-61.0, -40, -62]})
    known = planner.beliefs[0].posterior.measurements
    kept = [-61.0, -62.0]
    far = np.linalg.norm(log.positions_m[:, None] - places[[0, 2]], axis=2).min(axis=0) >= spacing
    assert known.power_dbm[len(log) :].tolist() == [
        power for power, is_far in zip(kept, far, strict=True) if is_far
    ]


def test_next_position_and_input() -> None:
    """A single integrator drives straight; a unicycle by its inputs to the same place."""
    problem = shortened("open_field", 10)
    plan = Planner(problem).step(problem.robots[0].start_m)
    start, step_s = np.array(problem.robots[0].start_m), problem.planner.step_s
    assert start + step_s * plan.next_input == pytest.approx(plan.next_position_m)
    turning = Unicycle(problem.robots[0].speed_max_m_s, 0.8)
    problem = replace(problem, robots=(replace(problem.robots[0], dynamics=turning),))
    problem = replace(problem, robots=(replace(problem.robots[0], start_rest=(0.3,)),))
    plan = Planner(problem).step(problem.robots[0].start_state)
    after = turning.step(tuple(problem.robots[0].start_state), tuple(plan.next_input), step_s)
    assert np.array(after) == pytest.approx(plan.next_state)


@pytest.mark.parametrize("name", ["open_field", "harbour_reach", "outdoor_map"])
def test_a_robot_that_is_carried_off(name: str) -> None:
    """A place beside the plan is planned from as well, and the proof is of that place."""
    problem = shortened(name, 10)
    planner = Planner(problem, seed=1)
    plans = planner.step_all([robot.start_state for robot in problem.robots])
    states = [plan.next_state.copy() for plan in plans]
    for state in states:
        state[:2] += 0.05
    again = planner.step_all(states)
    for plan, state in zip(again, states, strict=True):
        assert plan.positions_m[0] == pytest.approx(state[:2])
        assert plan.verdict is Verdict.VERIFIED
        assert plan.certificate.dynamics_defect < 1e-5


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ((1.0,), "should have shape"),
        ((1.0, 2.0, 3.0), "should have shape"),
        ((float("nan"), 2.0), "contains nan at index"),
        ("ab", "not an array of numbers"),
        (None, "not an array of numbers"),
        ((-1e6, 2.0), "outside world.bounds_m"),
    ],
)
def test_a_state_that_is_none(log: Measurements, state, words: str) -> None:
    """The error is ours, and the planner goes on as if nothing had been asked."""
    problem = shortened("open_field", 10)
    planner = Planner(problem, measurements=log, horizon=2)
    with pytest.raises(InputError, match=words):
        planner.step(state)
    first = planner.step(problem.robots[0].start_m)
    with pytest.raises(InputError, match=words):
        planner.step(state, {"x_m": [1.0], "y_m": [1.0], "power_dbm": [-50.0]})
    assert len(planner.beliefs[0].posterior.measurements) == len(log)
    assert planner.step(first.next_position_m).verdict is Verdict.VERIFIED


@pytest.mark.parametrize("connected", ["yes", 1.0, float("nan"), 2, None])
def test_links_are_truth_values(log: Measurements, connected) -> None:
    """Anything else is refused before anything is taken in."""
    problem = shortened("open_field", 10)
    planner = Planner(problem, measurements=log, horizon=2)
    first = planner.step(problem.robots[0].start_m)
    with pytest.raises(InputError, match=r"connected\[0\]"):
        planner.step_all([first.next_position_m], connected=[connected])
    assert "steps driven: 0" in repr(planner)
    assert planner.step(first.next_position_m, connected=np.bool_(True)).verdict is Verdict.VERIFIED


def test_a_power_at_the_floor_is_no_connection(log: Measurements) -> None:
    """A censored power lies below its value: at the threshold the robot is not connected."""
    problem = shortened("open_field", 10)
    (x, y), threshold = problem.robots[0].start_m, problem.stations[0].threshold_dbm
    for censored in (False, True):
        planner = Planner(problem, measurements=log, horizon=2)
        first = planner.step((x, y))
        heard = Measurements([first.next_position_m], [threshold], censored=[censored])
        planner.step(first.next_position_m, heard)
        assert planner._robots.connected[-1, 0] == (not censored)


NOTHING = {"x_m": [], "y_m": [], "power_dbm": []}


@pytest.mark.parametrize(
    ("name", "heard"),
    [
        ("open_field", NOTHING),
        ("open_field", Measurements(np.zeros((0, 2)), np.zeros(0))),
        ("open_field", [NOTHING]),
        ("two_station_courier", [NOTHING, NOTHING]),
        ("two_station_courier", [NOTHING, {"x_m": [30.0], "y_m": [30.0], "power_dbm": [-70.0]}]),
    ],
)
def test_empty_tables_of_measurements(name: str, heard) -> None:
    """Hearing nothing is the normal case of a real loop, from the first step on."""
    planner = Planner(shortened(name, 10), horizon=2)
    here = planner.problem.robots[0].start_m
    for _ in range(3):
        here = planner.step(here, heard).next_position_m
    counts = [len(each.measurements) for each in planner.beliefs[0].posteriors]
    assert planner.step(here).verdict is Verdict.VERIFIED
    assert counts == [len(each.measurements) for each in planner.beliefs[0].posteriors]


def test_refused_measurements_leave_the_planner_as_it_was(log: Measurements) -> None:
    """The same call without them plans as if the refused call had not been made."""
    problem = shortened("open_field", 10)
    planner, other = (Planner(problem, measurements=log, horizon=2) for _ in range(2))
    here = problem.robots[0].start_m
    here = np.unique([each.step(here).next_position_m for each in (planner, other)], axis=0)[0]
    for wrong in (
        {"x_m": [1.0], "y_m": [1.0], "power_dbm": [1e5]},
        {"x_m": [1.0], "y_m": [], "power_dbm": [-50.0]},
        {"x_m": [np.nan], "y_m": [1.0], "power_dbm": [-50.0]},
        "log.csv",
    ):
        with pytest.raises(InputError):
            planner.step(here, wrong)
    plan, expected = planner.step(here), other.step(here)
    assert np.array_equal(plan.positions_m, expected.positions_m)


def test_two_threads_cannot_share_a_planner() -> None:
    """The second call is refused while the first one plans; both threads end."""
    planner = Planner(shortened("open_field", 50), horizon=5)
    here, refused = planner.problem.robots[0].start_m, []

    def steps() -> None:
        for _ in range(5):
            try:
                planner.step(here)
            except InputError as error:
                refused.append(str(error))

    threads = [Thread(target=steps) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert refused
    assert "another thread" in refused[0]
    assert planner.step(here).verdict is Verdict.VERIFIED


def test_a_pickled_planner_continues() -> None:
    """The copy in another process has the beliefs and the last plan, and plans the same."""
    planner = Planner(shortened("open_field", 10), horizon=3)
    here = planner.step(planner.problem.robots[0].start_m).next_position_m
    copy = pickle.loads(pickle.dumps(planner))
    heard = Measurements([here], [-50.0])
    plan, other = planner.step(here, heard), copy.step(here, heard)
    np.testing.assert_array_equal(plan.positions_m, other.positions_m)
    assert len(copy.beliefs[0].posterior.measurements) == len(
        planner.beliefs[0].posterior.measurements
    )


def test_a_long_log_in_one_step(log: Measurements) -> None:
    """Memory is linear in the number of measurements, whether or not the spacing keeps them."""
    generator = np.random.default_rng(0)
    heard = Measurements(generator.uniform(0, (120, 60), (50_000, 2)), np.full(50_000, -55.0))
    problem = shortened("open_field", 10)
    planner = Planner(problem, measurements=log, horizon=2)
    tracemalloc.start()
    planner.step(problem.robots[0].start_m, heard)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e9
    known = planner.beliefs[0].posterior.measurements.positions_m
    nearest_m = cKDTree(known).query(known[len(log) :], 2)[0][:, 1]
    assert nearest_m.min() >= 0.999 * problem.channel.measure_spacing_m


def test_what_does_not_fit_the_problem(log: Measurements) -> None:
    """A robot in an obstacle, wrong numbers of robots and stations, and targets without a task."""
    problem = shortened("outdoor_map", 10)
    block = problem.workspace.obstacles[0]
    planner = Planner(problem, horizon=2)
    with pytest.raises(InputError, match=f"inside the obstacle {block.name}"):
        planner.step_all([block.polygon.centroid.coords[0] for _ in problem.robots])
    problem = shortened("open_field", 10)
    planner = Planner(problem, measurements=log, horizon=2)
    start = problem.robots[0].start_m
    for call in (
        lambda: planner.step(start, [log, log]),
        lambda: planner.step(start, {"x_m": [1.0]}),
        lambda: planner.step(start, target_m=(1.0, 1.0)),
        lambda: planner.step_all([start, start]),
        lambda: planner.step_all([start], connected=[True, False]),
        lambda: Planner(load("outdoor_track"), horizon=2).step(start),
        lambda: Planner(problem, horizon=0),
        lambda: Planner(problem, budget_s=-1.0),
        lambda: Planner(problem, measurements=3),
    ):
        with pytest.raises(InputError):
            call()


def test_a_predicted_connection_is_no_packet():
    """Only stated connections make a position certain; those that steps infer do not."""
    chances = []
    for stated in (None, True):
        planner = Planner(load("open_field"), horizon=3)
        place = planner.step(planner.problem.robots[0].start_m).next_position_m
        planner.step(place, connected=stated)
        plan = planner.step(place, connected=stated)
        chances.append(plan.connectivity[0])
    assert chances[0] < 1.0 == chances[1]
