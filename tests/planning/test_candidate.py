"""What a candidate costs, what the verifier says of it, and how it is written out."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import (
    THRESHOLD_DBM,
    WALL,
    bad_disc,
    bad_everywhere,
    belief_of,
    good_everywhere,
    kriged,
    small_problem,
    straight_path,
)
from scipy.stats import norm

from planopt import Verdict
from planopt.extend import Rung, Termination
from planopt.planning.candidates import Candidate, Scorer
from planopt.planning.plan import Pivot
from planopt.planning.proof.rule import VerifierContext
from planopt.planning.scene import build_scene
from planopt.planning.values.objective_value import ReachCost


def scorer_of(problem, power_at=good_everywhere, pivot=None) -> Scorer:
    """The scorer of a step from the problem's start."""
    start = np.asarray(problem.robots[0].start_m)
    belief = belief_of(problem, power_at)
    ahead = None if pivot is None else lambda _end_m: pivot
    cost = ReachCost(problem, start, belief.posterior.predict, ahead)
    index = build_scene(problem).index
    return Scorer(VerifierContext(problem, index, belief.posteriors, start), cost)


def assessed(scorer: Scorer, path_m) -> Candidate:
    path = np.asarray(path_m, dtype=float)
    return scorer.assessed(scorer.candidate(path, Rung.LATTICE, Termination.LATTICE_ONLY))


def test_objective_by_hand():
    """Two steps of 1.5 and 2 m, then 3 m to a pivot that is worth 10 m more, at 0.7 s/m."""
    scorer = scorer_of(small_problem(), pivot=Pivot(np.array([8.5, 18.0]), 10.0))
    path = np.array([(6.5, 15.0), (8.5, 15.0)])
    steps = (1.0 + 0.1 * 1.5**2) + (1.0 + 0.1 * 2.0**2)
    assert scorer.objective.rate_s_m == pytest.approx(0.7)
    assert scorer.objective(path) == pytest.approx(steps + 0.7 * 13.0)
    candidate = scorer.candidate(path, Rung.PLAN, Termination.CONVERGED)
    assert candidate.objective == candidate.lattice_objective == scorer.objective(path)


@pytest.mark.parametrize("price", [0.0, 3.0, 10.0])
def test_objective_out_of_contact_by_hand(price):
    """A metre below the bound counts 1 + price (1 - P), by the mean of each step's two ends."""
    problem = small_problem()
    problem = replace(problem, objective=replace(problem.objective, outage_price=price))
    scorer = scorer_of(problem, bad_disc(8.0, 15.0, 2.5), Pivot(np.array([13.0, 16.0]), 10.0, 2.5))
    path = np.array([(6.5, 15.0), (8.5, 15.0), (10.0, 15.5), (12.0, 16.0)])
    whole = np.vstack([(5.0, 15.0), path])
    mean, deviation = kriged(scorer.context, whole)
    # The start is measured, and connected for certain.
    score = (mean - THRESHOLD_DBM) / np.maximum(deviation, 1e-9)
    is_below = score < norm.ppf(0.9)
    assert 1 < is_below.sum() < 5
    share = np.where(is_below, norm.sf(score), 0.0)
    lengths = np.linalg.norm(np.diff(whole, axis=0), axis=1)
    charged = (lengths * (share[1:] + share[:-1]) / 2.0).sum()
    steps = (1.0 + 0.1 * lengths**2).sum()
    expected = steps + 0.7 * (price * charged + 2.5 * 1.0 + 10.0)
    assert scorer.objective(path) == pytest.approx(expected, rel=1e-9)


def test_slack_that_is_allowed_is_not_charged():
    """With the threshold lowered by the slack a faint place is in contact."""
    power, path = bad_disc(8.0, 15.0, 2.5), np.array([(6.5, 15.0), (8.5, 15.0)])
    hard = small_problem()
    rule = replace(hard.constraints.rule, slack_max_db=60.0)
    soft = replace(hard, constraints=replace(hard.constraints, rule=rule))
    free = scorer_of(hard).objective(path)
    assert scorer_of(soft, power).objective(path) == pytest.approx(free)
    assert scorer_of(hard, power).objective(path) > free + 1.0


def test_good_candidate_as_a_plan():
    """Everything the verifier predicted, the robot's own place first."""
    problem = small_problem(WALL)
    scorer = scorer_of(problem, bad_disc(20.0, 25.0, 4.0))
    path = straight_path(problem)
    candidate = assessed(scorer, path[1:])
    assert candidate.verdict is Verdict.VERIFIED
    assert candidate.sound and not candidate.relaxes
    plan = scorer.plan_from(candidate, 0.5)
    assert (plan.positions_m == path).all()
    assert (plan.t_s == np.arange(5.0)).all()
    mean, deviation = kriged(scorer.context, path)
    assert np.allclose(plan.mean_dbm, mean, atol=1e-8)
    assert np.allclose(plan.deviation_db, deviation, atol=1e-6)
    assert plan.connectivity[1:].min() == plan.certificate.min_connectivity
    assert (plan.wall_s, plan.rung, plan.message) == (0.5, Rung.LATTICE, "")


@pytest.mark.parametrize(
    "path",
    [
        [(19.0, 15.0), (21.0, 15.0)],
        [(18.0, 15.0), (19.45, 15.0)],
        [(20.0, 29.0), (18.0, 29.0)],
        [(18.0, 16.0), (np.nan, 16.0)],
    ],
)
def test_unsound(path):
    """Through a wall, too near to it, a jump, no number: not sound whatever is predicted."""
    problem = small_problem(WALL, start_m=(18.0, 15.0))
    candidate = assessed(scorer_of(problem), path)
    assert candidate.verdict is Verdict.VIOLATED
    assert not candidate.sound


def test_words_of_candidates():
    """What is below the bound is sound and says what it misses; a stand is no progress."""
    problem = small_problem()
    scorer = scorer_of(problem, bad_everywhere)
    candidate = assessed(scorer, straight_path(problem)[1:])
    assert candidate.sound and candidate.relaxes
    assert candidate.verdict is Verdict.VIOLATED
    assert "met nowhere" in scorer.plan_from(candidate, 0.0).message
    problem = small_problem()
    scorer = scorer_of(problem, bad_disc(5.0, 15.0, 3.5))
    candidate = assessed(scorer, straight_path(problem, 2.0)[1:])
    assert candidate.verdict is Verdict.VERIFIED and candidate.relaxes
    message = scorer.plan_from(candidate, 0.0).message
    assert message.startswith("P(connected) is below the required value at step 1:")
    assert f"{candidate.certificate.relaxation_db[0]:.2f} dB" in message
    scorer = scorer_of(small_problem())
    plan = scorer.plan_from(assessed(scorer, [(5.0, 15.0)] * 4), 0.0)
    assert plan.verdict is Verdict.FEASIBLE_UNVERIFIED
    assert "stands still" in plan.message
    scorer = scorer_of(small_problem(start_m=(34.5, 15.0)))
    plan = scorer.plan_from(assessed(scorer, [(34.5, 15.0)] * 4), 0.0)
    assert plan.verdict is Verdict.VERIFIED
