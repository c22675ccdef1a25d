"""A user's own loop steps networks and pursuers; a simulation of the same problem acts alike."""

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
    ):
        with refused():
            network.step(*arguments)


@pytest.mark.parametrize("planner", ["drive", "retarget", "receding"])
def test_pursuers_are_driven_through_their_reports(planner):
    """The loop asks the motes; aims and pursued evaders are those of the simulation."""
    problem = planopt.load("pursuit_several")
    run = planopt.simulate(problem, planner=planner, seed=2).value
    pursuers = planopt.Planner(problem, planner=planner, seed=2)
    for step, time_s in enumerate(run.times_s[:-1].tolist()):
        states = [each[step] for each in run.pursuers]

        def report(pursuer, evader, held, step=step, time_s=time_s, states=states):
            tracks = [Track(run.times_s[: step + 1], each[: step + 1]) for each in run.evaders_m]
            pair, here_m = (pursuer, evader), states[pursuer][:2]
            return run.scene.source.record(tracks, pair, here_m, time_s, held)

        captured = np.flatnonzero(run.capture_s <= time_s)
        action = pursuers.step(states, report, captured)
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
    with refused():
        pursuers.step([here, here], {})
    with refused():
        pursuers.step([here], {}, [0])
    with refused():
        planopt.Planner(planopt.load("pursuit_design"))
