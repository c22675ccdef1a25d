"""Attempts of one step: judged, and repeated with what the verifier objects to built in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reach_tasks import goal_nlp
from scenes import (
    CUP,
    WALL,
    bad_band,
    bad_disc,
    belief_of,
    context_of,
    good_everywhere,
    search_of,
    small_problem,
)

import planopt.planning.goal_refinement as refine
from planopt import Verdict
from planopt.extend import Rung
from planopt.planning.candidates import Budget, Scorer
from planopt.planning.proof.context import VerifierContext
from planopt.planning.search.pivot import Ahead
from planopt.planning.values.reach_cost import ReachCost


def refiner_of(problem, power_at=good_everywhere, lines=4):
    """A refiner of the step from the problem's start, its scorer and its start path."""
    search, _, scene = search_of(problem, power_at)
    belief = belief_of(problem, power_at)
    at = np.asarray(problem.robots[0].start_m)
    situation = context_of(problem, belief, at)
    start = search.find_start(situation)
    ahead = Ahead(problem, scene, start, None)
    reach_cost = ReachCost(problem, at, situation.power, ahead)
    scorer = Scorer(VerifierContext(problem, scene.index, belief.posteriors, at), reach_cost)
    nlp = goal_nlp(problem.planner.horizon, lines)
    cost = scorer.objective(start.path_m)
    refiner = refine.GoalRefinement(
        nlp, scene, situation, scorer, reach_cost, start, ahead, cost, Budget()
    )
    return refiner, scorer, start


@pytest.mark.parametrize("polygon", [WALL, CUP])
def test_first_attempt_is_good(polygon):
    """Verified, cheaper than the lattice path, with the solver's effort and residual."""
    problem = small_problem(polygon, start_m=(12.0, 15.0), horizon=10)
    refiner, scorer, start = refiner_of(problem)
    first = next(refiner.attempts(None))
    assert first.verdict is Verdict.VERIFIED
    assert first.rung is Rung.PLAN
    assert first.objective == scorer.objective(first.path_m) < scorer.objective(start.path_m)
    assert first.iterations > 0 and first.solve_s > 0.0
    assert first.kkt_residual < 1e-3
    assert set(first.multipliers) == {"speed", "line_end", "line_start", "connectivity"}


def test_attempts_end():
    """However often the caller is not content, and every one of them has been judged."""
    refiner, _, _ = refiner_of(small_problem(CUP, start_m=(18.0, 15.0), horizon=8))
    attempts = list(refiner.attempts(None))
    assert 1 < len(attempts) <= 4 * (refine.REPAIRS + 1)
    assert all(attempt.certificate is not None for attempt in attempts)
    assert {attempt.rung for attempt in attempts} == {Rung.PLAN, Rung.COLD_RETRY}


def test_shifted_plan_is_tried():
    """A cheaper last plan comes first, a dearer one last, one of another length not at all."""
    problem = small_problem(WALL, start_m=(12.0, 15.0), horizon=10)
    refiner, _, _ = refiner_of(problem)
    good = next(refiner.attempts(None)).path_m
    polished_from = []
    polish = refine.polish_path

    def noting(nlp, task):
        polished_from.append(task.path_m)
        return polish(nlp, task)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(refine, "polish_path", noting)
        # As a plan is shifted: standing at its end.
        next(refiner.attempts(np.vstack([good[:-1], good[-2]])))
        # Its last step leads on, as far as a step may.
        assert (polished_from[0][:-1] == good[:-1]).all()
        assert 1.0 < np.linalg.norm(polished_from[0][-1] - good[-2]) <= problem.step_length_m
        polished_from.clear()
        dear = np.tile((12.0, 15.0), (10, 1))
        list(refiner.attempts(dear))
        assert not (polished_from[0][:-1] == dear[:-1]).all()
        assert any((path[:-1] == dear[:-1]).all() for path in polished_from)


@pytest.mark.parametrize("width_m", [3.0, 6.0])
def test_a_hole_that_nothing_leads_round_is_crossed(width_m):
    """Attempts across it are verified, say what they miss, and cost what the verifier finds."""
    problem = small_problem(start_m=(15.0, 15.0), horizon=8)
    refiner, _, _ = refiner_of(problem, bad_band(18.0, 18.0 + width_m))
    verified = [a for a in refiner.attempts(None) if a.verdict is Verdict.VERIFIED]
    best = min(verified, key=lambda attempt: attempt.objective)
    assert best.rung is Rung.RELAXED and best.relaxes
    assert best.path_m[-1, 0] > 18.0 + width_m
    # Sums over steps are rougher than the verifier's grid: a step's share of the hole at most.
    step = problem.step_length_m * (1.0 + problem.reach.outage_price)
    assert best.certificate.path_cost_m == pytest.approx(best.certificate.best_cost_m, abs=step)


def test_relaxed_start_is_made_as_good_as_can_be():
    """Out of a hole: missing dB at the step that cannot keep the bound, none elsewhere."""
    problem = small_problem(horizon=6)
    refiner, scorer, start = refiner_of(problem, bad_disc(5.0, 15.0, 3.5))
    attempts = [a for a in refiner.attempts(None) if a.verdict is Verdict.VERIFIED]
    assert attempts
    lattice = scorer.assessed(scorer.candidate(start.path_m, Rung.LATTICE, attempts[0].termination))
    assert attempts[0].rung is Rung.RELAXED
    assert attempts[0].certificate.relaxed_steps == (1,)
    assert sum(attempts[0].certificate.relaxation_db) <= sum(lattice.certificate.relaxation_db)


def test_optimistic_neighbours_are_corrected(monkeypatch):
    """A local model that promises 3 dB too much: the proof objects, and is heard."""
    problem = small_problem(horizon=8)
    refiner, _, _ = refiner_of(problem, bad_disc(12.0, 15.0, 3.0))
    margins = refine.margins_of

    def rosy(*arguments):
        found = margins(*arguments)
        return replace(found, value=found.value + 3.0)

    monkeypatch.setattr(refine, "margins_of", rosy)
    assert any(attempt.verdict is Verdict.VERIFIED for attempt in refiner.attempts(None))
