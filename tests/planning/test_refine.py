"""Attempts of one step: judged, and repeated with what the verifier objects to built in."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scenes import (
    bad_band,
    bad_disc,
    belief_of,
    context_of,
    good_everywhere,
    search_of,
    small_problem,
)

import planopt.planning.refinement as refine
from planopt import Verdict
from planopt.extend import Rung
from planopt.planning.candidates import Scorer
from planopt.planning.proof.rule import VerifierContext
from planopt.planning.search.global_search import Ahead
from planopt.planning.search.guess_search import Guess
from planopt.planning.values.objective_value import ReachCost


def attempts_of(problem, power_at=good_everywhere):
    """Attempts from the lattice path of the problem's first step, their scorer and that path."""
    search, _, scene = search_of(problem, power_at)
    belief = belief_of(problem, power_at)
    at = np.asarray(problem.robots[0].start_m)
    situation = context_of(problem, belief, at)
    start = search.find_start(situation)
    ahead = Ahead(problem, scene, start, None)
    cost = ReachCost(problem, at, situation.power, ahead)
    scorer = Scorer(VerifierContext(problem, scene.index, belief.posteriors, at), cost)
    near = partial(refine.goal_value, cost, ahead.leading)
    guess = Guess(start.path_m, -cost(start.path_m), 0.0, clear=False, near=near)
    rung = Rung.RELAXED if (start.margin_db < 0.0).any() else Rung.PLAN
    found = refine.Refinement(problem, scene).candidates(situation, scorer, guess, rung)
    return found, scorer, start.path_m


@pytest.mark.parametrize("width_m", [3.0, 6.0])
def test_a_hole_that_nothing_leads_round_is_crossed(width_m):
    """Attempts across it are verified, say what they miss, and cost what the verifier finds."""
    problem = small_problem(start_m=(15.0, 15.0), horizon=8)
    attempts, _, _ = attempts_of(problem, bad_band(18.0, 18.0 + width_m))
    verified = [a for a in attempts if a.verdict is Verdict.VERIFIED]
    best = min(verified, key=lambda attempt: attempt.objective)
    assert best.rung is Rung.RELAXED and best.relaxes
    assert best.path_m[-1, 0] > 18.0 + width_m
    # Sums over steps are rougher than the verifier's grid: a step's share of the hole at most.
    step = problem.step_length_m * (1.0 + problem.reach.outage_price)
    assert best.certificate.path_cost_m == pytest.approx(best.certificate.best_cost_m, abs=step)


def test_relaxed_start_is_made_as_good_as_can_be():
    """Out of a hole: missing dB at the step that cannot keep the bound, none elsewhere."""
    problem = small_problem(horizon=6)
    found, scorer, path_m = attempts_of(problem, bad_disc(5.0, 15.0, 3.5))
    attempts = [a for a in found if a.verdict is Verdict.VERIFIED]
    assert attempts
    lattice = scorer.assessed(scorer.candidate(path_m, Rung.LATTICE, attempts[0].termination))
    assert attempts[0].rung is Rung.RELAXED
    assert attempts[0].certificate.relaxed_steps == (1,)
    assert sum(attempts[0].certificate.relaxation_db) <= sum(lattice.certificate.relaxation_db)


def test_optimistic_neighbours_are_corrected(monkeypatch):
    """A local model that promises 3 dB too much: the proof objects, and is heard."""
    problem = small_problem(horizon=8)
    margins = refine.margins_of

    def rosy(*arguments):
        found = margins(*arguments)
        return replace(found, value=found.value + 3.0)

    monkeypatch.setattr(refine, "margins_of", rosy)
    attempts, _, _ = attempts_of(problem, bad_disc(12.0, 15.0, 3.0))
    assert any(attempt.verdict is Verdict.VERIFIED for attempt in attempts)
