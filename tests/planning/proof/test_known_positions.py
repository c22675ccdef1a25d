"""A robot that stays at a measured position: rules, verdicts, searches, refinement and runs."""

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import TRACKING, context_of, scorer_of, terms_problem

from planopt import Verdict, load, simulate
from planopt.channel import Measurements
from planopt.planning.planners import planner_for
from planopt.planning.proof.verify import verify

ABOVE_DB = 0.5


def staying(above_db, p_min=0.9, **constraints):
    """The context of a robot whose position was measured at `above_db` over the threshold."""
    problem = terms_problem(TRACKING, p_min=p_min)
    if constraints:
        rule = replace(problem.constraints.rule, **constraints)
        problem = replace(problem, constraints=replace(problem.constraints, rule=rule))
    context, belief = context_of(problem)
    here = context.position_m
    # Half a chance by the model
    mean_dbm = belief.posterior.predict(here[None]).mean_db
    station = replace(problem.stations[0], threshold_dbm=float(mean_dbm[0]))
    posterior = belief.posterior.extend(Measurements(here[None], mean_dbm + above_db))
    known = replace(belief, posterior=posterior)
    problem = replace(problem, stations=(station,))
    context = replace(context, problem=problem, posteriors=(posterior,))
    return context, known, np.tile(here, (6, 1))


@pytest.mark.parametrize("connectivity", ["each_step", "average", "joint"])
@pytest.mark.parametrize("p_min", [0.6, 0.97])
def test_every_rule_knows_the_connection(connectivity, p_min):
    """Certain where a packet arrives, impossible where none does, whatever p_min."""
    context, _, path = staying(ABOVE_DB, p_min, connectivity=connectivity)
    (station,) = context.posteriors
    assert station.connectivity(path[:1], context.law.thresholds_dbm[0])[0] < 0.6
    found = verify(context, path)
    assert found.certificate.min_connectivity == 1.0
    assert found.certificate.rule is None or found.certificate.rule.achieved > 0.999
    assert found.verdict is Verdict.VERIFIED
    context, _, path = staying(-ABOVE_DB, p_min, connectivity=connectivity)
    found = verify(context, path)
    assert found.certificate.min_connectivity == 0.0
    assert found.verdict is Verdict.VIOLATED
    if connectivity == "each_step":
        assert found.certificate.relaxation_db == pytest.approx([ABOVE_DB] * 5)


@pytest.mark.parametrize("above_db", [ABOVE_DB, -ABOVE_DB])
def test_a_plan_is_verified_next_to_a_reading(above_db):
    """Search and refinement about a known position find what the verifier accepts."""
    context, belief, _ = staying(above_db, 0.6)
    scorer, ground = scorer_of(context, belief)
    planner = planner_for(context.problem, ground, np.random.default_rng(0))
    plan = planner.plan(replace(context, index=ground.index), scorer)
    assert plan.verdict is Verdict.VERIFIED


def test_predictions_of_solvers_ignore_readings():
    """They are smooth, and the same where nothing was measured."""
    context, _, path = staying(ABOVE_DB)
    here, there = path[:1], path[:1] + 0.3
    assert context.power(here).deviation_db[0] == 0.0
    assert context.predicted(here).deviation_db[0] > 0.0
    np.testing.assert_array_equal(context.power(there).mean_db, context.predicted(there).mean_db)


def test_revisited_positions_of_a_run_are_reported_as_known():
    """One if and only if connected where measured; one where only a packet had arrived before."""
    run = simulate(load("fig4"), seed=3, horizon=4)
    known = proven = 0
    for robot, belief in zip(run.runs, run.beliefs, strict=True):
        log, places = robot.log, belief.posterior.measurements.positions_m
        for step in range(2, len(log.t_s)):
            here = log.positions_m[step]
            visits = (log.positions_m[1:step] == here).all(axis=1)
            if visits.any():
                measured = (places == here).all(axis=1).any()
                known += measured
                assert not measured or log.connectivity[step] == log.connected[step]
            if log.connected[1:step][visits].any():
                proven += not (places == here).all(axis=1).any()
                assert log.connectivity[step] == 1.0
    assert known > 20 and proven > 5
