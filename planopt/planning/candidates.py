"""Candidates of one step: value, verification and time budget, and the fallback cascade."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np

from planopt.arrays import Floats
from planopt.channel.kriging import Prediction
from planopt.errors import InputError
from planopt.parts import part_of
from planopt.planning.certificate import Certificate, required_margins_db
from planopt.planning.free_space import leaving_path
from planopt.planning.plan import Plan, Rung, Termination, Verdict, shifted_drive
from planopt.planning.proof.motion import verify_motion
from planopt.planning.proof.rule import VerifierContext
from planopt.planning.proof.verify import Judgement, verify
from planopt.problems.problem import Problem
from planopt.robots.dynamics import Drive, rolled_out
from planopt.world.clearance import ObstacleIndex

SEARCH_SHARE, SOLVE_SHARE, PROOF_SHARE = 0.3, 0.4, 0.1
"""Fractions of the time budget: end of searches, limit of one solve, reserve for verification."""


@dataclass(frozen=True)
class Budget:
    """Deadlines for the computation of a plan, by :func:`time.perf_counter`."""

    ends_s: float = math.inf  # Latest start of a refinement
    search_ends_s: float = math.inf  # Deadline of searches, which return their best result
    proof_ends_s: float = math.inf  # Latest start of a verification if a candidate exists

    @property
    def spent(self) -> bool:
        """Return whether the deadline to start another refinement has passed."""
        return perf_counter() >= self.ends_s

    @property
    def searched(self) -> bool:
        """Return whether the deadline of searches has passed."""
        return perf_counter() >= self.search_ends_s

    @property
    def proven(self) -> bool:
        """Return whether the deadline to start another verification has passed."""
        return perf_counter() >= self.proof_ends_s


UNLIMITED = Budget()


def budget_from(problem: Problem, begun_s: float) -> Budget:
    """Return the deadlines of a plan; they reserve time to verify the path of the last solve."""
    budget_s = problem.planner.budget_s
    if budget_s is None:
        return UNLIMITED
    return Budget(
        ends_s=begun_s + (1.0 - SOLVE_SHARE - PROOF_SHARE) * budget_s,
        search_ends_s=begun_s + SEARCH_SHARE * budget_s,
        proof_ends_s=begun_s + (1.0 - PROOF_SHARE) * budget_s,
    )


def solve_limit_s(problem: Problem) -> float | None:
    """Return the time limit of one solve; None without a limit."""
    budget_s = problem.planner.budget_s
    return None if budget_s is None else SOLVE_SHARE * budget_s


@dataclass(frozen=True)
class Candidate:
    """Candidate path with its objective value and the verifier's findings."""

    path_m: Floats  # (N, 2)
    objective: float
    lattice_objective: float  # Objective of the step's initial guess
    rung: Rung
    termination: Termination
    found: Judgement | None = None  # None before verification
    solve_s: float = 0.0
    iterations: int = 0
    kkt_residual: float | None = None
    multipliers: dict[str, Floats] = field(default_factory=dict[str, Floats])
    drive: Drive | None = None  # States and inputs; None for the single integrator

    @property
    def certificate(self) -> Certificate | None:
        """Certificate of the verifier; None before verification."""
        return None if self.found is None else self.found.certificate

    @property
    def verdict(self) -> Verdict:
        """Verdict of the verifier; ``unverified`` before verification."""
        return Verdict.FEASIBLE_UNVERIFIED if self.found is None else self.found.verdict

    @property
    def sound(self) -> bool:
        """Return whether clearance, bounds, dynamics and robot separations are satisfied."""
        return self.found is not None and self.found.sound

    @property
    def relaxes(self) -> bool:
        """Return whether any step violates the chance constraint."""
        return self.certificate is not None and bool(self.certificate.relaxed_steps)

    @property
    def hopeless(self) -> bool:
        """Return whether every violation of the chance constraint is certified as unavoidable."""
        if self.certificate is None or len(self.certificate.relaxed_steps) < len(self.path_m):
            return False
        # With bounded slack, the verifier does not compute margins of reachable positions.
        return max(self.certificate.best_margin_db, default=0.0) < 0.0

    @property
    def avoidable(self) -> tuple[int, ...]:
        """Return the steps that violate p_min although a reachable position satisfies it."""
        if self.certificate is None:
            return ()
        # The margins are empty without a reachability search.
        best = zip(self.certificate.relaxed_steps, self.certificate.best_margin_db, strict=False)
        return tuple(step for step, margin in best if margin >= 0.0)

    @property
    def missing_db(self) -> float:
        """Return the shortfall of the chance constraint in dB, summed over the steps."""
        return 0.0 if self.certificate is None else sum(self.certificate.relaxation_db)


PathValue = Callable[..., float]
"""Objective as a function of a path (N, 2) and, for a robot with dynamics, the drive along it."""


@dataclass(frozen=True)
class Scorer:
    """Evaluation and verification of the candidate paths of one step."""

    context: VerifierContext
    objective: PathValue
    # (N, 2) remainder of the previous plan; the other robots avoid it
    reserved_m: Floats | None = None

    @property
    def problem(self) -> Problem:
        """Problem with the robot that plans."""
        return self.context.problem

    @property
    def index(self) -> ObstacleIndex:
        """Spatial index of the obstacles."""
        return self.context.index

    @property
    def position_m(self) -> Floats:
        """``(2,)`` position of the robot."""
        return self.context.position_m

    @property
    def state(self) -> Floats:
        """``(s,)`` state of the robot."""
        return self.context.state

    def margins_db(self, power: Prediction) -> Floats:
        """Return the margins in dB by which predicted powers satisfy p_min."""
        return required_margins_db(self.problem, power)

    def candidate(
        self, path_m: Floats, rung: Rung, termination: Termination, drive: Drive | None = None
    ) -> Candidate:
        """Return an unverified candidate for a path, with its objective value."""
        # A failed solve may return NaN.
        found = self.objective(path_m, drive) if np.isfinite(path_m).all() else -self.sense * np.inf
        return Candidate(path_m, found, found, rung, termination, drive=drive)

    @property
    def sense(self) -> float:
        """Return 1 if the objective is maximised, -1 if it is minimised."""
        return 1.0 if self.problem.sense == "max" else -1.0

    def score(self, candidate: Candidate) -> float:
        """Return a candidate's objective value, negated if it is minimised."""
        return self.sense * candidate.objective

    def assessed(self, candidate: Candidate) -> Candidate:
        """Return the candidate with the verifier's findings."""
        path = np.vstack([self.position_m, candidate.path_m])
        found = verify(self.context, path, candidate.kkt_residual, candidate.drive)
        return replace(candidate, found=found)

    def standing(self, horizon: int) -> Candidate:
        """Return a waiting candidate or, if waiting is unsafe, one that moves out of the way."""
        # Alternatives: the reservation, which others avoid, and a path out of obstacles.
        place = np.tile(self.position_m, (horizon, 1))
        found = self.assessed(self.candidate(place, Rung.STOP, Termination.NO_PATH))
        if found.sound:
            return found
        if self.reserved_m is not None and not np.array_equal(self.reserved_m, place):
            found = self.assessed(
                self.candidate(self.reserved_m, Rung.RESERVED, Termination.STOPPED)
            )
            if found.sound:
                return found
        path = leaving_path(self.problem, self.index, self.context.moving, self.position_m)
        if path is None:
            return found
        return self.assessed(self.candidate(path, Rung.LEAVE, Termination.NO_PATH))

    def plan_from(self, chosen: Candidate, wall_s: float) -> Plan:
        """Return a verified candidate as a plan."""
        if chosen.found is None:
            raise AssertionError("only assessed candidates are released")
        plan = chosen.found.plan(
            self.problem,
            np.vstack([self.position_m, chosen.path_m]),
            chosen.objective,
            chosen.lattice_objective,
            chosen.rung,
            chosen.termination,
            chosen.drive,
        )
        return replace(
            plan,
            wall_s=wall_s,
            solve_s=chosen.solve_s,
            iterations=chosen.iterations,
            multipliers=chosen.multipliers,
        )


def released(scorer: Scorer, path_m: Floats, begun_s: float) -> Plan:
    """Return the plan of an unrefined path, or a stationary plan if the path is unsafe.

    Parameters
    ----------
    scorer
        Evaluation and verification of the path.
    path_m
        ``(N, 2)`` positions after each step.
    begun_s
        Start time of planning by :func:`time.perf_counter`.

    Raises
    ------
    InputError
        If the shape of `path_m` is not (N, 2) for the horizon N.
    """
    part_of("scorer", scorer, Scorer, "give the scorer first, then the path")
    shape = (scorer.problem.planner.horizon, 2)
    try:
        path_m = np.asarray(path_m, dtype=np.float64)
    except (TypeError, ValueError):
        path_m = np.zeros(0)
    if path_m.shape != shape:
        raise InputError(
            f"has shape {path_m.shape}, should have shape {shape}",
            key="path_m",
            remedy="give x and y in metres after each of the planner.horizon steps",
        )
    found = scorer.assessed(scorer.candidate(path_m, Rung.PLAN, Termination.LATTICE_ONLY))
    rejected = ""
    if not found.sound and found.certificate is not None:
        rejected = "; ".join(found.certificate.reasons)
        found = scorer.standing(len(path_m))
    return replace(scorer.plan_from(found, wall_s=perf_counter() - begun_s), rejected=rejected)


def held(context: VerifierContext, path: list[Floats]) -> Floats:
    """Return positions (N, 2) that follow `path` and then stay at its end."""
    horizon = context.problem.planner.horizon
    last = path[-1] if path else context.position_m
    return np.asarray([*path, *[last] * (horizon - len(path))])[:horizon]


def verified_of(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the verified candidates in their original order."""
    return [candidate for candidate in candidates if candidate.verdict is Verdict.VERIFIED]


def best_of(
    scorer: Scorer, candidates: Sequence[Candidate], warm: Plan | None, least: float = -math.inf
) -> Candidate:
    """Return the best verified candidate, or a fallback if no candidate is verified."""
    # An unverified candidate is released only if its value is at least `least`.
    verified = verified_of(candidates)
    if verified:
        return with_effort(max(verified, key=scorer.score), candidates)
    sound = [c for c in candidates if c.sound and scorer.score(c) >= least]
    if not scorer.problem.robots[0].moves_freely:
        sound.sort(key=lambda candidate: candidate.missing_db)
    if any(candidate.hopeless for candidate in sound):
        return with_effort(sound[0], candidates)
    fallback = without_guess(scorer, warm)
    chosen = fallback if fallback.verdict is Verdict.VERIFIED or not sound else sound[0]
    return with_effort(chosen, candidates)


def with_effort(chosen: Candidate, candidates: Sequence[Candidate]) -> Candidate:
    """Return the chosen candidate with the total solver time and iterations of all candidates."""
    refined = [c for c in candidates if c.termination is not Termination.LATTICE_ONLY]
    return replace(
        chosen,
        solve_s=sum(c.solve_s for c in refined),
        iterations=sum(c.iterations for c in refined),
        termination=refined[-1].termination if refined else chosen.termination,
    )


def shifted_path(scorer: Scorer, warm: Plan | None) -> Floats | None:
    """Return positions (N, 2): the last verified plan's remainder, then waiting; else None."""
    # None if the plan is unverified, no longer drivable, or for a robot with dynamics.
    if warm is None or warm.verdict is not Verdict.VERIFIED or warm.drive is not None:
        return None
    rest = np.vstack([warm.positions_m[2:], warm.positions_m[-1:]])
    if len(rest) != scorer.problem.planner.horizon:
        return None
    whole = np.vstack([scorer.position_m, rest])
    moved = verify_motion(scorer.problem, scorer.index, scorer.state, whole, None)
    return None if moved.reasons else rest


def without_guess(scorer: Scorer, warm: Plan | None) -> Candidate:
    """Return the remainder of the last plan if it is still verified, else a stop."""
    problem = scorer.problem
    if not problem.robots[0].moves_freely:
        return _driven_without_guess(scorer, warm)
    path = shifted_path(scorer, warm)
    if path is not None:
        shifted = scorer.assessed(scorer.candidate(path, Rung.SHIFTED, Termination.STOPPED))
        if shifted.verdict is Verdict.VERIFIED:
            return shifted
    return scorer.standing(problem.planner.horizon)


def _driven_without_guess(scorer: Scorer, warm: Plan | None) -> Candidate:
    """Return the remainder of the last plan if verified; else braking at once or after it."""
    problem, horizon = scorer.problem, scorer.problem.planner.horizon
    shifted = shifted_drive(problem, warm)
    rest: Candidate | None = None
    if shifted is not None and warm is not None and len(shifted.inputs) == horizon:
        rest = scorer.assessed(drive_candidate(scorer, shifted, Rung.SHIFTED, Termination.STOPPED))
        if rest.verdict is Verdict.VERIFIED and warm.verdict is Verdict.VERIFIED:
            return rest
    stop = scorer.assessed(drive_candidate(scorer, braked(scorer), Rung.STOP, Termination.NO_PATH))
    if stop.sound or rest is None:
        return stop
    if len(scorer.context.moving):
        return replace(rest, rung=Rung.RESERVED)
    return replace(rest, rung=Rung.STOP, termination=Termination.NO_PATH) if rest.sound else stop


def braked(scorer: Scorer) -> Drive:
    """Return the trajectory of a robot with dynamics that brakes over the horizon."""
    settings, dynamics = scorer.problem.planner, scorer.problem.robots[0].dynamics
    inputs = dynamics.braking(scorer.state, settings.step_s, settings.horizon)
    return rolled_out(dynamics, scorer.state, inputs, settings.step_s)


def drive_candidate(
    scorer: Scorer, drive: Drive, rung: Rung, termination: Termination
) -> Candidate:
    """Return an unverified candidate for the trajectory of a robot with dynamics."""
    return scorer.candidate(drive.positions_m[1:], rung, termination, drive)
