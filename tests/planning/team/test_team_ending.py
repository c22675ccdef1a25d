"""How runs end: connected, with nothing left to learn, stalled, or after their steps."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from terms_scene import CONNECT, LEARNING, TRACKING, context_of, scorer_of, terms_problem

import planopt.planning.planners as one_step_module
from planopt import Measurements, Obstacle, Verdict, check
from planopt.extend import Rung
from planopt.planning.loop.drive import STALL_STEPS, Progress, terms_ending
from planopt.planning.loop.log import Outcome
from planopt.planning.solve import simulate
from planopt.planning.values.context import left_to_learn

HERE = np.array([10.0, 15.0])
MAPPING = {"kind": "mapping", "form": "information"}


def plan_of(verdict=Verdict.VERIFIED, rung=Rung.PLAN, then_m=0.0):
    """A plan as endings look at it: it waits, and then drives on for so far."""
    places = HERE + np.array([[0.0, 0.0], [0.0, 0.0], [then_m, 0.0]])
    return SimpleNamespace(rung=rung, verdict=verdict, message="", drive=None, positions_m=places)


def driven(problem, places, learnt, plan=None, posteriors=None):
    """One robot that was driven along `places`."""
    found = context_of(problem)[0].law.posteriors if posteriors is None else posteriors
    return Progress(
        problem, [np.asarray(p) for p in places], learnt, [plan or plan_of()] * len(learnt), found
    )


def standing(problem, **changes):
    """One robot that stands for a step and learns nothing."""
    return driven(problem, [HERE, HERE], [False], **changes)


def no_packet(steps=1, robots=1):
    return np.zeros((steps, robots), dtype=bool)


def test_all_robots_must_be_connected_at_once() -> None:
    problem = terms_problem(CONNECT, max_steps=3)
    going = driven(problem, [HERE, HERE + 1.0, HERE + 2.0], [True, True])
    one_by_one = np.array([[True, False], [False, True]])
    assert terms_ending(problem, one_by_one, [going, going]) is None
    limit = np.vstack([one_by_one, [[False, False]]])
    outcome, _ = terms_ending(problem, limit, [going, going])
    assert outcome is Outcome.STEP_LIMIT
    together = np.array([[True, False], [True, True]])
    ended = terms_ending(problem, together, [going, going])
    assert ended == (Outcome.COMPLETED, "connected after step 2")
    assert terms_ending(terms_problem(LEARNING, max_steps=3), together, [going, going]) is None


@pytest.mark.parametrize("term", [LEARNING, MAPPING])
def test_who_stands_with_places_left_to_measure_has_stalled(term) -> None:
    """Before the last step and at it; and who measures, or waits, has not."""
    for most in (8, 1):
        problem = terms_problem(term, max_steps=most)
        outcome, reason = terms_ending(problem, no_packet(), [standing(problem)])
        assert outcome is Outcome.STALLED
        assert reason == "standing still with nothing new to learn; places are left to measure"
    problem = terms_problem(term, max_steps=8)
    assert terms_ending(problem, no_packet(), [driven(problem, [HERE, HERE], [True])]) is None
    for plan in (plan_of(rung=Rung.SHIFTED), plan_of(then_m=1.0)):
        assert terms_ending(problem, no_packet(), [standing(problem, plan=plan)]) is None
    last = terms_problem(term, max_steps=1)
    ended = terms_ending(last, no_packet(), [driven(last, [HERE, HERE], [True])])
    assert ended == (Outcome.COMPLETED, "all 1 steps driven")


def everything_measured(problem):
    """What is believed once all of the workspace has been measured."""
    context, _ = context_of(problem)
    lattice = scorer_of(*context_of(problem))[1].road_map
    step = 0.6 * problem.channel.measure_spacing_m
    x = np.arange(*problem.workspace.bounds_m[::2], step)
    y = np.arange(*problem.workspace.bounds_m[1::2], step)
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    assert len(lattice.nodes_m)
    posterior = context.posterior
    return SimpleNamespace(measurements=SimpleNamespace(positions_m=places), real=posterior)


def test_with_nothing_left_to_learn_a_run_is_completed() -> None:
    """All places that can be come to are measured, between the nodes of the search as well."""
    problem = terms_problem(LEARNING, max_steps=9)
    problem = replace(problem, channel=replace(problem.channel, measure_spacing_m=2.0))
    known = everything_measured(problem)
    ended = terms_ending(problem, no_packet(), [standing(problem, posteriors=[known])])
    assert ended == (Outcome.COMPLETED, "nothing left to learn after step 1")
    # One gap is enough, also one without a node in it.
    node = scorer_of(*context_of(problem))[1].road_map
    gap = np.array([30.0, 31.0])
    away = np.linalg.norm(node.nodes_m - gap, axis=1).min()
    places = known.measurements.positions_m
    kept = places[np.linalg.norm(places - gap, axis=1) > 2.3]
    some = SimpleNamespace(measurements=SimpleNamespace(positions_m=kept))
    left = left_to_learn(
        problem, scorer_of(*context_of(problem))[1].index, node.lattice, HERE, [some]
    )
    assert len(left) and np.linalg.norm(left - gap, axis=1).max() < 2.0 + away
    outcome, _ = terms_ending(problem, no_packet(), [standing(problem, posteriors=[some])])
    assert outcome is Outcome.STALLED


def test_places_behind_a_wall_are_no_reason_to_go_on() -> None:
    problem = terms_problem(LEARNING, max_steps=9)
    problem = replace(problem, channel=replace(problem.channel, measure_spacing_m=2.0))
    known = everything_measured(problem)
    places = known.measurements.positions_m
    near = SimpleNamespace(measurements=SimpleNamespace(positions_m=places[places[:, 0] < 27.0]))
    wall = Obstacle("wall", shapely.box(25.0, -1.0, 26.0, 41.0))
    walled = replace(problem, workspace=replace(problem.workspace, obstacles=(wall,)))
    outcome, _ = terms_ending(problem, no_packet(), [standing(problem, posteriors=[near])])
    assert outcome is Outcome.STALLED
    outcome, _ = terms_ending(walled, no_packet(), [standing(walled, posteriors=[near])])
    assert outcome is Outcome.COMPLETED


def test_below_the_threshold_nothing_is_left() -> None:
    """A map that is as good as was asked."""
    term = {"kind": "mapping", "form": "path", "closeness_per_m": 0.0}
    for threshold, outcome in ((1e4, Outcome.COMPLETED), (0.1, Outcome.STALLED)):
        problem = terms_problem({**term, "variance_threshold_db2": threshold})
        assert terms_ending(problem, no_packet(), [standing(problem)])[0] is outcome


def test_a_run_goes_on_while_one_robot_does() -> None:
    """But at its end the robot that stands is named, if nothing can set it going again."""
    problem = terms_problem(LEARNING, max_steps=2, coordination="decoupled")
    robot = problem.robots[0]
    both = replace(problem, robots=(robot, replace(robot, name="other")))
    still, going = standing(problem), driven(problem, [HERE, HERE + 1.0], [True])
    assert terms_ending(both, no_packet(1, 2), [still, going]) is None
    outcome, reason = terms_ending(both, no_packet(2, 2), [still, going])
    assert outcome is Outcome.STALLED
    assert reason.startswith(f"{robot.name}: standing still") and "other" not in reason
    # What the others plan may leave it something to do.
    joint = replace(both, planner=replace(both.planner, coordination="joint"))
    assert terms_ending(joint, no_packet(2, 2), [still, going])[0] is Outcome.COMPLETED


def test_places_that_the_others_measured_are_not_left() -> None:
    """A joint team is done once the map is good enough by anyone; a decoupled robot is not."""
    term = {"kind": "mapping", "form": "path", "variance_threshold_db2": 6.0}
    problem = terms_problem(term, max_steps=99)
    robot = problem.robots[0]
    x, y = np.meshgrid(np.arange(0.0, 41.0, 3.0), np.arange(0.0, 41.0, 3.0))
    everywhere = np.column_stack([x.ravel(), y.ravel()])
    (before,) = context_of(problem)[0].law.posteriors
    knowing = before.extend(Measurements(everywhere, np.full(len(everywhere), -50.0)))
    circling = [HERE, HERE + 0.1] * 20
    track = [HERE, *everywhere, *circling]
    one = driven(problem, circling, [False] * (len(circling) - 1))
    other = driven(problem, track, [False] * (len(track) - 1), posteriors=[knowing])
    for coordination, outcome in (("joint", Outcome.COMPLETED), ("decoupled", Outcome.STALLED)):
        team = replace(
            problem,
            robots=(robot, replace(robot, name="other")),
            planner=replace(problem.planner, coordination=coordination),
        )
        assert terms_ending(team, no_packet(39, 2), [one, other])[0] is outcome


def test_standing_beside_a_target_is_no_stall() -> None:
    """As long as packets arrive; without any for long it is."""
    problem = terms_problem(TRACKING, max_steps=99)
    track = [HERE] * (STALL_STEPS + 1)
    robot = driven(problem, track, [False] * STALL_STEPS)
    assert terms_ending(problem, no_packet(), [standing(problem)]) is None
    served = no_packet(STALL_STEPS)
    served[4] = True
    assert terms_ending(problem, served, [robot]) is None
    assert terms_ending(problem, no_packet(STALL_STEPS), [robot])[0] is Outcome.STALLED


@pytest.mark.parametrize("name", ["random", "auto"])
def test_who_draws_anew_may_go_on(name) -> None:
    """A random direction may be free in the next step."""
    problem = terms_problem(LEARNING, max_steps=99, name=name)
    ended = terms_ending(problem, no_packet(), [standing(problem)])
    assert (ended is None) == (name == "random")


def with_threshold(threshold_dbm, **planner):
    """The small problem of finding connection, with a threshold."""
    problem = terms_problem(CONNECT, horizon=3, **planner)
    station = replace(problem.stations[0], threshold_dbm=threshold_dbm)
    return replace(problem, stations=(station,))


@pytest.mark.parametrize("threshold_dbm", [-45.0, 60.0])
def test_a_run_ends_once_connected(tmp_path, threshold_dbm) -> None:
    """By the true power, and judged from disk; never where no place connects."""
    problem = with_threshold(threshold_dbm, max_steps=4)
    run = simulate(problem, seed=1)
    log = run.runs[0].log
    connected = np.asarray(log.true_dbm)[1:] >= threshold_dbm
    assert connected.any() == (threshold_dbm < 0.0)
    assert (run.runs[0].outcome is Outcome.COMPLETED) == connected.any()
    if connected.any():
        assert len(connected) == int(np.argmax(connected)) + 1
    run.save(tmp_path)
    verdict = check(tmp_path)
    assert verdict.verdict in (Verdict.VERIFIED, Verdict.VIOLATED)
    assert not [reason for reason in verdict.reasons if "the run ends" in reason]


def test_a_stalled_run_is_judged_from_disk(tmp_path, monkeypatch) -> None:
    """One step ahead among measured places, with no way out: named, saved and found again."""
    monkeypatch.setattr(one_step_module, "path_to_unmeasured", lambda *_: None)
    problem = terms_problem(LEARNING, horizon=1, name="one_step", max_steps=20)
    problem = replace(problem, channel=replace(problem.channel, measure_spacing_m=9.0))
    run = simulate(problem, seed=0)
    first = run.runs[0]
    assert first.outcome is Outcome.STALLED
    assert len(first.log.t_s) - 1 < 20
    assert run.metrics["measured_steps"] == first.metrics.measured_steps
    run.save(tmp_path)
    assert check(tmp_path).reasons == ()
