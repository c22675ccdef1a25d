"""The fallback cascade: which candidate of a step is released.

Planners give candidates in order of promise: refined initial guesses, then the guesses themselves.
The best verified one is released. Without any, the remainder of the previous plan or stopping is
tried: connectivity may be given up, clearance and speed never.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from planopt.planning.judge import Candidate, Judge
from planopt.planning.plan import Plan, Rung, Termination, Verdict, shifted_drive, shifted_path
from planopt.robots.drive import Drive, rolled_out


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
