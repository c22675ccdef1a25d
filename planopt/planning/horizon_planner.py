"""Receding-horizon step for a sum of terms: initial guesses and fallback cascade."""

from dataclasses import replace
from time import perf_counter

import numpy as np

from planopt.arrays import Floats
from planopt.planning.candidates import (
    Budget,
    Candidate,
    Scorer,
    best_of,
    budget_from,
    drive_candidate,
    shifted_path,
    verified_of,
)
from planopt.planning.plan import Plan, Rung, Termination, Verdict, shifted_drive
from planopt.planning.programme.path_nlp import METHODS
from planopt.planning.proof.motion import swept_motion, verify_apart, verify_motion
from planopt.planning.refinement import Refinement
from planopt.planning.scene import Ground
from planopt.planning.search.guess_search import COUPLED_GUESSES, Guess, GuessSearch
from planopt.planning.search.local_ranking import can_climb
from planopt.planning.search.place_paths import path_to_unmeasured, paths_to_good_place
from planopt.planning.values.context import StepContext, bends_guesses
from planopt.planning.values.objective_value import ObjectiveValue, rule_missing
from planopt.problems.problem import Problem
from planopt.robots.dynamics import Drive, rolled_out

CLOSE_SHARE = 0.01
"""Relative loss to the best guess beyond which a batch-optimised guess is rarely worth refining."""
MERGED_STEPS = 2.0
"""Distance, in longest steps, within which a guess is assumed to converge to a refined path."""


def driven_starts(
    scorer: Scorer, context: StepContext, starts: list[Guess], warm: Plan | None
) -> list[Guess]:
    """Return initial guesses that satisfy the dynamics, best first, and unsafe guesses last."""
    problem = scorer.problem
    dynamics, step_s = problem.robots[0].dynamics, problem.planner.step_s
    found: list[Guess] = []
    for start in starts:
        inputs = dynamics.following(scorer.state, start.path_m, step_s)
        drive = rolled_out(dynamics, scorer.state, inputs, step_s)
        found.append(driven_start(scorer, context, drive))
    last = last_drive(problem, warm)
    if last is not None:
        found.append(driven_start(scorer, context, last))
    found.sort(key=lambda start: (not start.clear, round(start.missing_db, 2), -start.value))
    return found


def last_drive(problem: Problem, warm: Plan | None) -> Drive | None:
    """Return the previous plan's remainder followed by braking; None without a verified plan."""
    shifted = shifted_drive(problem, warm)
    if shifted is None or warm is None or warm.verdict is not Verdict.VERIFIED:
        return None
    return shifted if len(shifted.inputs) == problem.planner.horizon else None


def driven_start(scorer: Scorer, context: StepContext, drive: Drive) -> Guess:
    """Return states and inputs of a drive as an initial guess."""
    candidate = drive_candidate(scorer, drive, Rung.LATTICE, Termination.LATTICE_ONLY)
    path = candidate.path_m
    moved = verify_motion(scorer.problem, scorer.index, scorer.state, drive.positions_m, drive)
    swept = swept_motion(scorer.problem, drive.positions_m, drive)
    apart = verify_apart(scorer.context.moving, swept)
    clear = not (moved.reasons or apart.reasons)
    missing = rule_missing(context, path)
    return Guess(path, scorer.score(candidate), missing, drive, clear)


DRIVEN_ROUNDS = 12
"""Maximum number of further refinements of the best drive, each with new separating lines."""
SETTLED_SHARE = 3e-3  # Relative gain below which refinement ends


class FallbackCascade:
    """Selection of a candidate from guesses and fallbacks; it caches the refinement solvers."""

    def __init__(self, problem: Problem, ground: Ground) -> None:
        self._problem = problem
        coupled = bends_guesses(problem) and problem.planner.horizon > 1
        self._followed = COUPLED_GUESSES if coupled else 1
        self._driven = not problem.robots[0].moves_freely
        # In goal tasks, the next terminal waypoint cancels any further gain.
        again = self._driven and not problem.has_goal
        self._rounds = DRIVEN_ROUNDS if again else 0
        refines = problem.planner.name in METHODS and problem.can_be_polished
        self.refinement = Refinement(problem, ground) if refines else None

    def first_verified(
        self,
        context: StepContext,
        scorer: Scorer,
        starts: list[Guess],
        warm: Plan | None,
        budget: Budget,
    ) -> Candidate:
        """Return the first verified candidate from guesses and fallbacks, else the safest one."""
        candidates: list[Candidate] = []
        verified: list[Candidate] = []
        for number, start in enumerate(starts):
            unrefined = replace(
                scorer.candidate(start.path_m, Rung.LATTICE, Termination.LATTICE_ONLY, start.drive),
                lattice_objective=scorer.sense * starts[0].value,
            )
            if self.refinement is None:
                unrefined = replace(unrefined, rung=Rung.PLAN)
            else:
                rung = Rung.PLAN if number < self._followed or self._driven else Rung.COLD_RETRY
                for candidate in self.refinement.candidates(context, scorer, start, rung, budget):
                    if candidate.verdict is Verdict.VERIFIED:
                        verified.append(candidate)
                    candidates.append(candidate)
                if budget.spent and not verified:
                    unrefined = replace(unrefined, termination=Termination.TIME_LIMIT)
            if any(c.sound and c.hopeless for c in candidates):
                break
            if budget.proven and any(c.sound for c in candidates):
                break
            if not any(scorer.score(c) >= scorer.score(unrefined) for c in verified):
                unrefined = scorer.assessed(unrefined)
                if unrefined.relaxes and self._problem.has_goal:
                    unrefined = replace(unrefined, rung=Rung.RELAXED)
                candidates.append(unrefined)
                if unrefined.verdict is Verdict.VERIFIED:
                    verified.append(unrefined)
            if verified and self._is_settled(starts, number + 1, verified):
                break
        if not verified and not self._driven and not budget.spent:
            found = self._by_good_place(context, scorer, candidates, budget)
            verified += verified_of(found)
            candidates += found
        for _ in range(self._rounds):
            if not verified or budget.spent:
                break
            best = max(scorer.score(candidate) for candidate in verified)
            found = self._once_more(context, scorer, starts, verified, budget)
            verified += verified_of(found)
            candidates += found
            gained = max(scorer.score(candidate) for candidate in verified) - best
            if gained <= SETTLED_SHARE * abs(best):
                break
        return best_of(scorer, candidates, warm)

    def _is_settled(self, starts: list[Guess], number: int, verified: list[Candidate]) -> bool:
        """Return whether guess `number` is unlikely to yield a better verified candidate."""
        if self._driven:
            return False
        if number >= min(self._followed, len(starts)):
            return True
        # Only batch-optimised guesses have values that predict those of their refinements.
        start, best, longest_m = starts[number], starts[0], self._problem.step_length_m
        if not can_climb(self._problem):
            return False
        if start.value < best.value - CLOSE_SHARE * abs(best.value):
            return True
        return any(
            np.abs(start.path_m - candidate.path_m).max() <= MERGED_STEPS * longest_m
            for candidate in verified
        )

    def _by_good_place(
        self, context: StepContext, scorer: Scorer, candidates: list[Candidate], budget: Budget
    ) -> list[Candidate]:
        """Return candidates that lead to a reachable position where p_min is satisfied."""
        found: list[Candidate] = []
        for path in paths_to_good_place(scorer, candidates):
            unrefined = scorer.candidate(path, Rung.COLD_RETRY, Termination.LATTICE_ONLY)
            if self.refinement is not None:
                start = Guess(path, scorer.score(unrefined), rule_missing(context, path))
                refined = self.refinement.candidates(
                    context, scorer, start, Rung.COLD_RETRY, budget
                )
                found += [replace(candidate, rung=Rung.COLD_RETRY) for candidate in refined]
            found.append(scorer.assessed(unrefined))
            if any(candidate.verdict is Verdict.VERIFIED for candidate in found):
                break
        return found

    def _once_more(
        self,
        context: StepContext,
        scorer: Scorer,
        starts: list[Guess],
        verified: list[Candidate],
        budget: Budget,
    ) -> list[Candidate]:
        """Refine the best candidate again, with data and separating lines chosen near its path."""
        if self.refinement is None:
            return []
        best = max(verified, key=scorer.score)
        again = Guess(best.path_m, starts[0].value, 0.0, best.drive, charge=starts[0].charge)
        rung = best.rung if best.rung is Rung.COLD_RETRY else Rung.PLAN
        return self.refinement.candidates(context, scorer, again, rung, budget)


class HorizonPlanner:
    """Planner for one robot of a problem whose objective is a sum of terms."""

    def __init__(
        self, problem: Problem, ground: Ground, _generator: np.random.Generator | None = None
    ) -> None:
        self.problem = problem
        self.ground = ground
        self._search = GuessSearch(problem, ground)
        self.cascade = FallbackCascade(problem, ground)

    def plan(self, context: StepContext, scorer: Scorer, warm: Plan | None = None) -> Plan:
        """Return a plan from the robot's state; `warm` is the previous plan."""
        begun = perf_counter()
        budget = budget_from(self.problem, begun)
        shifted = shifted_path(scorer, warm)
        starts = self._search.find_guesses(context, shifted, budget)
        exit_m = self._exit_path(context, starts)
        if exit_m is not None:
            out = Guess(exit_m, scorer.objective(exit_m), rule_missing(context, exit_m))
            if context.measuring.takes(exit_m).any():
                # The path yields a measurement, so it competes with the other guesses.
                starts = sorted([*starts, out], key=lambda start: -start.value)
            elif (plan := self._released(context, scorer, out, warm, begun)) is not None:
                return plan
        if not self.problem.robots[0].moves_freely:
            starts = driven_starts(scorer, context, starts, warm)
        chosen = self.cascade.first_verified(context, scorer, starts, warm, budget)
        return scorer.plan_from(chosen, wall_s=perf_counter() - begun)

    def _exit_path(self, context: StepContext, starts: list[Guess]) -> Floats | None:
        """Return a path to an unmeasured position if no guess yields measurements, else None."""
        # Otherwise None, also if no term uses measurements or no unmeasured position is left.
        terms = self.problem.terms
        if not any(term.is_measured for term in terms) or not all(
            term.is_measured or term.structure == "chain" for term in terms
        ):
            return None
        score = ObjectiveValue(context)
        for start in starts:
            gains = zip(terms, score.by_term(start.path_m), strict=True)
            if any(gain > 0.0 for term, gain in gains if term.is_measured):
                return None
        return path_to_unmeasured(context, self.ground)

    def _released(
        self, context: StepContext, scorer: Scorer, start: Guess, warm: Plan | None, begun_s: float
    ) -> Plan | None:
        """Return the plan of an unrefined guess; None if it is not verified."""
        if not self.problem.robots[0].moves_freely:
            start = driven_starts(scorer, context, [start], warm)[0]
        rung = Rung.PLAN if self.cascade.refinement is None else Rung.LATTICE
        found = scorer.assessed(
            scorer.candidate(start.path_m, rung, Termination.LATTICE_ONLY, start.drive)
        )
        if found.verdict is not Verdict.VERIFIED:
            return None
        return scorer.plan_from(found, wall_s=perf_counter() - begun_s)
