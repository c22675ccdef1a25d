"""A calibrated law of connection in the verifier, the rules, the searches and the solver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import expit

from planopt.channel.belief import Belief
from planopt.channel.connection.connection_law import ConnectionLaw, ConnectionOutcomes
from planopt.channel.prediction import connection_probability
from planopt.planning.plan import Verdict
from planopt.planning.proof.circumstances import circumstances_of
from planopt.planning.proof.verify import judge
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import build_scene
from planopt.problems.constraints import ConnectivityRule
from planopt.problems.problem import Problem
from planopt.world.clearance import index_obstacles
from tests.planning.scenes import THRESHOLD_DBM, belief_of, small_problem, straight_path

LAW = ConnectionLaw(-0.8, 1.2)


def sloping(positions_m: np.ndarray) -> np.ndarray:
    """Falls by a dB a metre, through the threshold at 20 m."""
    return THRESHOLD_DBM + 20.0 - positions_m[:, 0]


def with_law(belief: Belief, law: ConnectionLaw | None) -> Belief:
    """What is believed, with this law of connection; None for the normal one."""
    outcomes = None
    if law is not None:
        nothing = np.zeros(0)
        outcomes = ConnectionOutcomes(THRESHOLD_DBM, nothing, nothing.astype(bool), 0, law)
    return replace(belief, posterior=replace(belief.posterior, outcomes=outcomes))


def asked(p_min: float, **rule) -> Problem:
    """The small problem, hard, with `p_min` under a rule."""
    problem = small_problem(horizon=6)
    form = ConnectivityRule(**{"connectivity": "each_step", "slack_max_db": 0.0, **rule})
    return replace(problem, constraints=replace(problem.constraints, p_min=p_min, rule=form))


def judged(problem: Problem, belief: Belief, path: np.ndarray):
    """The verifier's judgement of a path."""
    under = circumstances_of(problem, belief.posteriors)
    index = index_obstacles(problem.workspace)
    return judge(problem, index, belief.posterior, path[0], path, circumstances=under)


def chances(judgement) -> np.ndarray:
    """Probability of a connection at each place of a judged path."""
    power = judgement.power
    return connection_probability(power.mean_db, power.deviation_db, THRESHOLD_DBM)


def logits(belief: Belief, path: np.ndarray, law: ConnectionLaw = LAW) -> np.ndarray:
    """Of the calibrated probabilities, from mean and deviation as they are."""
    power = belief.posterior.predict(path)
    return law.intercept + law.slope * (power.mean_db - THRESHOLD_DBM) / power.deviation_db


def test_certified_probability_is_the_calibrated_one() -> None:
    """Of every step, and so the least."""
    problem = asked(0.5)
    path, belief = straight_path(problem), with_law(belief_of(problem, sloping), LAW)
    found = judged(problem, belief, path)
    expected = expit(logits(belief, path))
    np.testing.assert_allclose(chances(found), expected, rtol=1e-9)
    assert found.certificate.min_connectivity == pytest.approx(expected[1:].min())


@pytest.mark.parametrize("by", [-1e-3, 1e-3])
def test_p_min_means_the_calibrated_probability(by: float) -> None:
    """A plan is verified with p_min just below its least probability, and not just above."""
    base = asked(0.5)
    path, belief = straight_path(base), with_law(belief_of(base, sloping), LAW)
    least = float(expit(logits(belief, path))[1:].min())
    verdict = judged(asked(least + by), belief, path).verdict
    assert verdict is (Verdict.VERIFIED if by < 0.0 else Verdict.VIOLATED)


def test_neutral_law_judges_nearly_as_the_normal_one() -> None:
    """Probabilities within 0.0095 of each other."""
    problem = asked(0.5)
    path, belief = straight_path(problem), belief_of(problem, sloping)
    normal = judged(problem, belief, path)
    neutral = judged(problem, with_law(belief, ConnectionLaw()), path)
    apart = np.abs(chances(normal) - chances(neutral))
    assert 0.0 < apart.max() < 0.0095


@pytest.mark.parametrize("form", ["average", "joint", "data", "probable data", "outage"])
def test_rules_rest_on_the_calibrated_law(form: str) -> None:
    """One step, of which every rule says what its probability is."""
    keys = {
        "average": {"connectivity": "average"},
        "joint": {"connectivity": "joint"},
        "data": {"data_mbit": 1.0, "deadline_s": 1.0, "rate_mbit_s": 1.0, "connectivity": "data"},
        "outage": {"connectivity": "outage", "outage_max_m": 0.5},
    }
    keys["probable data"] = keys["data"]
    base = asked(0.5)
    belief = with_law(belief_of(base, sloping), LAW)
    path = np.array([[16.0, 15.0], [17.5, 15.0]])
    chance = float(expit(logits(belief, path))[1])
    assert 0.6 < chance < 0.95
    p_min = {"data": 0.0}.get(form, 0.5)
    problem = asked(p_min, **keys[form])
    problem = replace(problem, planner=replace(problem.planner, horizon=1))
    result = judged(problem, belief, path).certificate.rule
    if form == "outage":
        assert result.achieved == 0.0
        harder = replace(problem.constraints, p_min=chance + 1e-3)
        missed = judged(replace(problem, constraints=harder), belief, path).certificate.rule
        assert missed.achieved > 0.0
        return
    assert result.achieved == pytest.approx(chance, abs=0.02 if form == "probable data" else 2e-3)


@pytest.mark.parametrize("planner", ["auto", "lattice", "scp"])
def test_planners_keep_the_calibrated_bound(planner: str) -> None:
    """A plan toward a goal beyond the last place that keeps it stops there, and is verified."""
    problem = small_problem(p_min=0.9, horizon=8, planner=planner)
    belief = with_law(belief_of(problem, sloping), LAW)
    planning = ReachPlanner(problem, build_scene(problem))
    start = problem.robots[0].start_state
    plan = planning.plan(belief, start)
    normal = planning.plan(with_law(belief, None), start)
    np.testing.assert_allclose(
        plan.connectivity, expit(logits(belief, plan.positions_m)), rtol=1e-9
    )
    assert plan.verdict is Verdict.VERIFIED
    kept = [step for step in range(1, 9) if step not in plan.certificate.relaxed_steps]
    assert (plan.connectivity[kept] >= 0.9 - 1e-6).all()
    # The flatter law asks for more power, which there is only further west.
    steps = min(len(kept), 4)
    assert plan.positions_m[: steps + 1, 0].max() <= normal.positions_m[:, 0].max() + 1e-6
