"""A user's own loop steps networks and pursuers; a simulation of the same problem acts alike."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from test_coverage import SMALL

import planopt
from planopt.coverage import signals
from planopt.pursuit import Track


@pytest.mark.parametrize("planner", ["law", "receding"])
def test_a_network_is_driven_through_its_events(tmp_path, planner):
    """The loop draws what agents read; positions and teams are those of the simulation."""
    (tmp_path / "problem.toml").write_text(SMALL.replace("duration_s = 200", "duration_s = 30"))
    problem = planopt.load(tmp_path / "problem.toml")
    run = planopt.simulate(problem, planner=planner, seed=5).value
    network = planopt.Planner(problem, planner=planner, seed=5)
    # The seed draws the starts first, then the noise of the sensors.
    rng = np.random.default_rng(5)
    problem.starts(rng)
    scene = problem.scene
    positions_m = run.positions_m[0]
    for step, time_s in enumerate(run.times_s[:-1].tolist()):
        read = [signals(e, scene.sensing, positions_m, time_s, rng) for e in scene.events]
        action = network.step(positions_m, read)
        np.testing.assert_array_equal(action.states, run.states[step])
        positions_m = action.motion.places_m
        np.testing.assert_array_equal(positions_m, run.positions_m[step + 1])
    assert (run.states >= 0).any()


def test_an_agent_that_was_pushed_returns(tmp_path):
    """Positions are those of the user's agents, not those that were planned."""
    (tmp_path / "problem.toml").write_text(SMALL)
    network = planopt.Planner(planopt.load(tmp_path / "problem.toml"))
    quiet = np.zeros((1, 12))
    first = network.step(readings=quiet)
    pushed = first.motion.places_m.copy()
    pushed[3] = (1.0, 1.0)
    action = network.step(pushed, quiet)
    moved_m = np.linalg.norm(action.motion.places_m - pushed, axis=1)
    assert (moved_m <= 2.0 + 1e-9).all() and moved_m[3] > 0.1
    for arguments in (
        ([[1.0, 1.0]], quiet),
        (pushed - 50.0, quiet),
        (pushed,),
        (pushed, [[np.nan] * 12]),
        (np.full((12, 2), np.nan), quiet),
        ([[1.0], [1.0, 2.0]], quiet),
        ("positions", quiet),
        (pushed, quiet[0]),
    ):
        with refused():
            network.step(*arguments)


@pytest.mark.parametrize("planner", ["drive", "retarget", "receding"])
def test_pursuers_are_driven_through_their_reports(planner):
    """The loop asks the motes; aims and pursued evaders are those of the simulation."""
    problem = planopt.load("pursuit_several")
    run = planopt.simulate(problem, planner=planner, seed=2).value
    pursuers = planopt.Planner(problem, planner=planner, seed=2)
    held = {}
    for step, time_s in enumerate(run.times_s[:-1].tolist()):
        states = [each[step] for each in run.pursuers]
        tracks = [Track(run.times_s[: step + 1], each[: step + 1]) for each in run.evaders_m]
        for pair in np.ndindex(len(states), len(tracks)):
            here_m = states[pair[0]][:2]
            held[pair] = run.scene.source.record(tracks, pair, here_m, time_s, held.get(pair))
        captured = np.flatnonzero(run.capture_s <= time_s)
        action = pursuers.step(states, held, captured)
        np.testing.assert_array_equal(action.aims_m, run.aims_m[:, step])
        np.testing.assert_array_equal(action.chased, run.chased[:, step])
    assert len(run.uses) > 3


def test_reports_may_be_a_table():
    """A pursuer without a report stays; with one it drives there."""
    problem = planopt.load("pursuit_fleeing")
    pursuers = planopt.Planner(problem)
    here = np.array(problem.config.pursuers[0].start_m)
    np.testing.assert_array_equal(pursuers.step([here], {}).aims_m, [here])
    record = planopt.problems.Record(0.0, np.array([50.0, 60.0]), 5.0)
    np.testing.assert_array_equal(pursuers.step([here], {(0, 0): record}).aims_m, [[50.0, 60.0]])
    for states, reports, captured in (
        ([here, here], {}, ()),
        ([[np.nan, 0.0]], {}, ()),
        ([here], {}, [0]),
        ([here], {}, [3]),
        ([here], None, ()),
        ([here], {(0, 5): record}, ()),
        ([here], {(0, 0): "north"}, ()),
        ([here], {(0, 0): replace(record, reported_m=np.full(2, np.nan))}, ()),
        ([here], {(0, 0): replace(record, sampled_s=100.0)}, ()),
    ):
        with refused():
            pursuers.step(states, reports, captured)
    with refused():
        planopt.Planner(problem, seed=-1)
    with refused():
        planopt.Planner(planopt.load("pursuit_design"))


def test_a_pursuer_in_a_building_is_refused():
    """A pursuer beside a building or beyond the bounds drives around it; inside, none can."""
    problem = planopt.load("pursuit_obstacles")
    report = {(0, 0): planopt.problems.Record(0.0, np.array([250.0, 90.0]), 5.0)}
    for place in ([59.0, 90.0], [-1.0, 90.0]):
        assert planopt.Planner(problem).step([place], report).aims_m[0, 0] < 60.0
    with refused():
        planopt.Planner(problem).step([[100.0, 90.0]], report)


def test_an_agent_near_an_obstacle_returns():
    """An agent that drifted into the clearance is planned from the nearest allowed position."""
    network = planopt.Planner(planopt.load("coverage_obstacles"), planner="receding")
    places_m = network.step().motion.places_m.copy()
    places_m[0] = (23.9, 10.0)  # The clearance of the wall at x = 24 is 0.5 m
    assert network.step(places_m).motion.places_m[0, 0] <= 23.5 + 1e-9
