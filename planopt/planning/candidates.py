"""Candidates of one step: their value, verification and time budget, and the fallback cascade.

Planners give candidates in order of promise: refined initial guesses, then the guesses themselves.
The best verified one is released. Without any, the remainder of the previous plan or stopping is
tried: connectivity may be given up, clearance and speed never.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, connection_probability
from planopt.errors import InputError
from planopt.parts import part_of
from planopt.planning.certificate import Certificate, plan_message
from planopt.planning.free_space import leaving_path
from planopt.planning.plan import Plan, Rung, Termination, Verdict, shifted_drive, shifted_path
from planopt.planning.proof.context import VerifierContext
from planopt.planning.proof.verify import verify
from planopt.planning.tolerances import margins_asked_db
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive, rolled_out
from planopt.world.clearance import ObstacleIndex

SEARCH_SHARE = 0.3
"""Searches improve on what they have found until this share of a budget is over."""
SOLVE_SHARE = 0.4
"""No solve takes longer than this share of a budget."""
PROOF_SHARE = 0.1
"""This share is left for the proof of the last solve's path."""


@dataclass(frozen=True)
class Budget:
    """Times by :func:`time.perf_counter`; infinite where there is no limit."""

    ends_s: float = math.inf  # No new refinement begins any more
    search_ends_s: float = math.inf  # What searches have found by then has to do
    # No further candidate is judged any more where there is one that may be released
    proof_ends_s: float = math.inf

    @property
    def spent(self) -> bool:
        """Return whether no new refinement may begin."""
        return perf_counter() >= self.ends_s

    @property
    def searched(self) -> bool:
        """Return whether searches end with what they have."""
        return perf_counter() >= self.search_ends_s

    @property
    def proven(self) -> bool:
        """Return whether no further candidate is judged."""
        return perf_counter() >= self.proof_ends_s


UNLIMITED = Budget()
"""No limit."""


def budget_from(problem: Problem, begun_s: float) -> Budget:
    """The budget of a plan that was begun at `begun_s`, by :func:`time.perf_counter`.

    The last solve begins early enough to end, and to be judged, within it.
    """
    budget_s = problem.planner.budget_s
    if budget_s is None:
        return UNLIMITED
    return Budget(
        ends_s=begun_s + (1.0 - SOLVE_SHARE - PROOF_SHARE) * budget_s,
        search_ends_s=begun_s + SEARCH_SHARE * budget_s,
        proof_ends_s=begun_s + (1.0 - PROOF_SHARE) * budget_s,
    )


def solve_limit_s(problem: Problem) -> float | None:
    """Return how long one solve may take; None where there is no limit."""
    budget_s = problem.planner.budget_s
    return None if budget_s is None else SOLVE_SHARE * budget_s


@dataclass(frozen=True)
class Candidate:
    """A path that may be released."""

    path_m: NDArray[np.float64]  # (N, 2)
    # What it is worth, in the sense of the problem, and the same of the lattice path of the same
    # step
    objective: float
    lattice_objective: float
    rung: Rung  # Where it comes from
    termination: Termination
    # What the verifier says; None and feasible_unverified before it was asked
    certificate: Certificate | None = None
    verdict: Verdict = Verdict.FEASIBLE_UNVERIFIED
    solve_s: float = 0.0  # Of the solver
    iterations: int = 0
    kkt_residual: float | None = None
    multipliers: dict[str, NDArray[np.float64]] = field(
        default_factory=dict[str, NDArray[np.float64]]
    )
    # Whether clearance, bounds, motion model and the distance from what moves are kept, whatever
    # connectivity is
    sound: bool = False
    # What the verifier predicted along the path, the robot's own place first
    power: Prediction | None = None
    # How the robot drives along the path; None for the single integrator
    drive: Drive | None = None

    @property
    def relaxes(self) -> bool:
        """Return whether some step misses the connectivity bound."""
        return self.certificate is not None and bool(self.certificate.relaxed_steps)

    @property
    def hopeless(self) -> bool:
        """Return whether the certificate shows that no path at all meets the bound at any step."""
        if self.certificate is None or len(self.certificate.relaxed_steps) < len(self.path_m):
            return False
        # Where slack is bounded, no search shows anything.
        return max(self.certificate.best_margin_db, default=0.0) < 0.0

    @property
    def avoidable(self) -> tuple[int, ...]:
        """Steps that miss the bound although a place that meets it is said to be within reach."""
        if self.certificate is None:
            return ()
        # Without a search for places there are none.
        named = zip(self.certificate.relaxed_steps, self.certificate.best_margin_db, strict=False)
        return tuple(step for step, margin in named if margin >= 0.0)

    @property
    def missing_db(self) -> float:
        """Return by how much its steps miss the connectivity bound, in all."""
        return 0.0 if self.certificate is None else sum(self.certificate.relaxation_db)


@dataclass(frozen=True)
class Judge:
    """Everything a candidate of one step is judged by."""

    context: VerifierContext  # The problem, the belief, the robot's state and what moves
    objective: Callable[[NDArray[np.float64]], float]  # Value of a path (N, 2) from there
    # (N, 2) the rest of the last plan, which the other robots keep clear of; None without
    reserved_m: NDArray[np.float64] | None = None
    # Value of a drive, if it does not depend on its positions alone; else None
    objective_of_drive: Callable[[Drive], float] | None = None

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.context.problem

    @property
    def index(self) -> ObstacleIndex:
        """The obstacles."""
        return self.context.index

    @property
    def position_m(self) -> NDArray[np.float64]:
        """``(2,)`` where the robot is."""
        return self.context.position_m

    @property
    def state(self) -> NDArray[np.float64]:
        """``(s,)`` the robot's state, its position first."""
        return self.context.state

    def margins_db(self, power: Prediction) -> NDArray[np.float64]:
        """Connectivity margins of the step's problem."""
        return margins_asked_db(self.problem, power)

    def candidate(
        self,
        path_m: NDArray[np.float64],
        rung: Rung,
        termination: Termination,
        drive: Drive | None = None,
    ) -> Candidate:
        """Make a candidate of a path, not yet verified; `drive` says how it is driven."""
        # A solver may give back places that are no numbers.
        found = self.sense * -np.inf
        if np.isfinite(path_m).all():
            by_drive = None if drive is None else self.objective_of_drive
            found = self.objective(path_m) if by_drive is None or drive is None else by_drive(drive)
        return Candidate(path_m, found, found, rung, termination, drive=drive)

    @property
    def sense(self) -> float:
        """1 where more of the objective is better, -1 where less is: times this it is a worth."""
        return 1.0 if self.problem.sense == "max" else -1.0

    def worth(self, candidate: Candidate) -> float:
        """More is better, whatever the sense of the problem."""
        return self.sense * candidate.objective

    def judged(self, candidate: Candidate) -> Candidate:
        """Ask the verifier."""
        path = np.vstack([self.position_m, candidate.path_m])
        judgement = verify(self.context, path, candidate.kkt_residual, candidate.drive)
        return replace(
            candidate,
            certificate=judgement.certificate,
            verdict=judgement.verdict,
            sound=judgement.sound,
            power=judgement.power,
        )

    def standing(self, horizon: int) -> Candidate:
        """Stand still for N = `horizon` steps; if that is not sound go on as reserved, or leave.

        Every robot's plan keeps clear of what the others have reserved, so that this is the last
        resort that no other robot is in the way of. A robot that is where it must not be moves
        away (:func:`planopt.planning.free_space.leaving_path`).
        """
        place = np.tile(self.position_m, (horizon, 1))
        standing = self.judged(self.candidate(place, Rung.STOP, Termination.NO_PATH))
        if standing.sound:
            return standing
        rest = standing
        if self.reserved_m is not None and not np.array_equal(self.reserved_m, place):
            rest = self.judged(self.candidate(self.reserved_m, Rung.RESERVED, Termination.STOPPED))
            if rest.sound:
                return rest
        moving = self.context.moving
        path = leaving_path(self.problem, self.index, moving, self.position_m)
        if path is None:
            return rest
        return self.judged(self.candidate(path, Rung.LEAVE, Termination.NO_PATH))

    def plan_from(self, chosen: Candidate, wall_s: float) -> Plan:
        """Write a judged candidate out as a plan."""
        if chosen.certificate is None or chosen.power is None:
            raise AssertionError("only judged candidates are released")
        power = chosen.power
        positions = np.vstack([self.position_m, chosen.path_m])
        radio = self.problem.stations[0]
        return Plan(
            robot=self.problem.robots[0].name,
            t_s=self.problem.planner.step_s * np.arange(len(positions), dtype=np.float64),
            positions_m=positions,
            mean_dbm=power.mean_db,
            deviation_db=power.deviation_db,
            connectivity=connection_probability(
                power.mean_db, power.deviation_db, radio.threshold_dbm
            ),
            objective=chosen.objective,
            lattice_objective=chosen.lattice_objective,
            termination=chosen.termination,
            verdict=chosen.verdict,
            rung=chosen.rung,
            certificate=chosen.certificate,
            wall_s=wall_s,
            solve_s=chosen.solve_s,
            iterations=chosen.iterations,
            multipliers=chosen.multipliers,
            message=plan_message(chosen.certificate, positions),
            sense=self.problem.sense,
            drive=chosen.drive,
        )


def released(judge: Judge, path_m: NDArray[np.float64], begun_s: float) -> Plan:
    """The plan of a path (N, 2) that no solver touched, or the one to stand where it is not sound.

    Parameters
    ----------
    judge
        What it is judged by.
    path_m
        Where the steps end.
    begun_s
        When planning began, by :func:`time.perf_counter`.

    Raises
    ------
    InputError
        `path_m` has another shape than (N, 2) of the horizon N.
    """
    part_of("judge", judge, Judge, "give the judge first, then the path")
    shape = (judge.problem.planner.horizon, 2)
    try:
        path_m = np.asarray(path_m, dtype=np.float64)
    except (TypeError, ValueError):
        path_m = np.zeros(0)
    if path_m.shape != shape:
        raise InputError(
            f"has the shape {path_m.shape}, should have {shape}",
            key="path_m",
            remedy="give a place in metres after each step of planner.horizon",
        )
    found = judge.judged(judge.candidate(path_m, Rung.PLAN, Termination.LATTICE_ONLY))
    if not found.sound:
        found = judge.standing(len(path_m))
    return judge.plan_from(found, wall_s=perf_counter() - begun_s)


def held(context: VerifierContext, path: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """A path of N steps that begins with `path` and then stands; (N, 2)."""
    horizon = context.problem.planner.horizon
    last = path[-1] if path else context.position_m
    return np.asarray([*path, *[last] * (horizon - len(path))])[:horizon]


def verified_of(tried: Sequence[Candidate]) -> list[Candidate]:
    """Return the verified candidates, in their order."""
    return [candidate for candidate in tried if candidate.verdict is Verdict.VERIFIED]


def best_of(
    judge: Judge, tried: Sequence[Candidate], warm: Plan | None, least: float = -math.inf
) -> Candidate:
    """Return the best verified candidate, else the safest fallback.

    An unverified candidate is released only if its value is at least `least`.
    """
    verified = verified_of(tried)
    if verified:
        return with_effort(max(verified, key=judge.worth), tried)
    sound = [c for c in tried if c.sound and judge.worth(c) >= least]
    if not judge.problem.robots[0].moves_freely:
        sound.sort(key=lambda candidate: candidate.missing_db)
    if any(candidate.hopeless for candidate in sound):
        return with_effort(sound[0], tried)
    fallback = without_guess(judge, warm)
    chosen = fallback if fallback.verdict is Verdict.VERIFIED or not sound else sound[0]
    return with_effort(chosen, tried)


def with_effort(chosen: Candidate, tried: Sequence[Candidate]) -> Candidate:
    """Add the solver's time and iterations of all candidates, and its last termination."""
    refined = [c for c in tried if c.termination is not Termination.LATTICE_ONLY]
    return replace(
        chosen,
        solve_s=sum(c.solve_s for c in refined),
        iterations=sum(c.iterations for c in refined),
        termination=refined[-1].termination if refined else chosen.termination,
    )


def without_guess(judge: Judge, warm: Plan | None) -> Candidate:
    """Return the remainder of the previous verified plan, verified again; else a stop."""
    problem = judge.problem
    if not problem.robots[0].moves_freely:
        return _driven_without_guess(judge, warm)
    path = shifted_path(problem, judge.index, judge.position_m, warm)
    if path is not None:
        shifted = judge.judged(judge.candidate(path, Rung.SHIFTED, Termination.STOPPED))
        if shifted.verdict is Verdict.VERIFIED:
            return shifted
    return judge.standing(problem.planner.horizon)


def _driven_without_guess(judge: Judge, warm: Plan | None) -> Candidate:
    """Brake immediately if that is collision-free, otherwise after the previous plan.

    The remainder of the previous plan is collision-free whatever is believed of the channel, and
    the other robots keep clear of it.
    """
    problem, horizon = judge.problem, judge.problem.planner.horizon
    shifted = shifted_drive(problem, warm)
    rest: Candidate | None = None
    if shifted is not None and warm is not None and len(shifted.inputs) == horizon:
        rest = judge.judged(drive_candidate(judge, shifted, Rung.SHIFTED, Termination.STOPPED))
        if rest.verdict is Verdict.VERIFIED and warm.verdict is Verdict.VERIFIED:
            return rest
    stop = judge.judged(drive_candidate(judge, braked(judge), Rung.STOP, Termination.NO_PATH))
    if stop.sound or rest is None:
        return stop
    if len(judge.context.moving):
        return replace(rest, rung=Rung.RESERVED)
    return replace(rest, rung=Rung.STOP, termination=Termination.NO_PATH) if rest.sound else stop


def braked(judge: Judge) -> Drive:
    """Return the trajectory of a robot with dynamics that brakes over the horizon."""
    settings, dynamics = judge.problem.planner, judge.problem.robots[0].dynamics
    inputs = dynamics.braking(judge.state, settings.step_s, settings.horizon)
    return rolled_out(dynamics, judge.state, inputs, settings.step_s)


def drive_candidate(judge: Judge, drive: Drive, rung: Rung, termination: Termination) -> Candidate:
    """Return a driven trajectory as a candidate, not yet verified."""
    return judge.candidate(drive.positions_m[1:], rung, termination, drive)
