"""Why no way leads to the goal: the clearance, an obstacle, or steps too long for the lattice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from planopt.errors import InputError, NoPlanError
from planopt.planning.explain.explanation import Relaxation, towards
from planopt.planning.explain.key import DIGITS
from planopt.planning.free_space import is_joined, widest_clearance_m
from planopt.planning.plan import Verdict
from planopt.planning.scene import build_scene
from planopt.planning.tolerances import CLEARANCE_PAD_M
from planopt.problems.problem import Problem

SolveAgain = Callable[[Problem], Verdict]
"""Solves a changed problem and says what its plan is worth."""

BISECTIONS = 12
"""Of the clearance, where the lattice needs more room than there is."""

MOST_OBSTACLES = 60
"""With more, it is not tried which of them could go."""

SHORTER = 0.9
STEPS_TRIED = 20
"""The lattice is made finer by this factor, so many times at most."""


def explain_no_way(problem: Problem, solve_again: SolveAgain) -> tuple[Relaxation, ...]:
    """What would open a way to the goal, each change by itself.

    Parameters
    ----------
    problem
        For which :func:`planopt.planning.scene.build_scene` found none.
    solve_again
        Judges the changed problems.
    """
    found = [_clearance(problem, solve_again)]
    if is_joined(problem, problem.constraints.clearance_m):
        found.append(_step(problem, solve_again))
    else:
        found += _obstacles(problem, solve_again)
    return tuple(relaxation for relaxation in found if relaxation is not None)


def _clearance(problem: Problem, solve_again: SolveAgain) -> Relaxation | None:
    """The largest clearance with which a way is found."""
    widest = widest_clearance_m(problem)
    asked = problem.constraints.clearance_m
    if widest is None:
        return None
    fits = towards(max(widest - 1.1 * CLEARANCE_PAD_M, 0.0), DIGITS, down=True)
    if not _is_open(_with_clearance(problem, fits)):
        low, high = 0.0, fits
        if not _is_open(_with_clearance(problem, low)):
            return None
        for _ in range(BISECTIONS):
            middle = towards(0.5 * (low + high), DIGITS, down=True)
            low, high = (
                (middle, high) if _is_open(_with_clearance(problem, middle)) else (low, middle)
            )
        fits = low
    return Relaxation(
        "constraints.clearance_m",
        "m",
        asked,
        (),
        asked - fits,
        "m",
        fits,
        solve_again(_with_clearance(problem, fits)) is Verdict.VERIFIED,
        problem.robots[0].name,
    )


def _obstacles(problem: Problem, solve_again: SolveAgain) -> list[Relaxation | None]:
    """Every obstacle without which there is a way."""
    obstacles = problem.workspace.obstacles
    if len(obstacles) > MOST_OBSTACLES:
        return []
    found: list[Relaxation | None] = []
    for obstacle in obstacles:
        rest = tuple(other for other in obstacles if other is not obstacle)
        changed = replace(problem, workspace=replace(problem.workspace, obstacles=rest))
        if is_joined(changed, problem.constraints.clearance_m) and _is_open(changed):
            verified = solve_again(changed) is Verdict.VERIFIED
            key = f"world.obstacles ({obstacle.name})"
            name = problem.robots[0].name
            found.append(Relaxation(key, "", None, (), None, "", None, verified, name))
    return found


def _step(problem: Problem, solve_again: SolveAgain) -> Relaxation | None:
    """A shorter step, which makes the lattice fine enough for a way that there is."""
    asked = problem.planner.step_s
    for power in range(1, STEPS_TRIED + 1):
        step_s = towards(asked * SHORTER**power, DIGITS, down=True)
        changed = replace(problem, planner=replace(problem.planner, step_s=step_s))
        try:
            if not _is_open(changed):
                continue
        except InputError:
            return None  # the lattice would have too many nodes
        verified = solve_again(changed) is Verdict.VERIFIED
        name = problem.robots[0].name
        return Relaxation(
            "planner.step_s", "s", asked, (), asked - step_s, "s", step_s, verified, name
        )
    return None


def _with_clearance(problem: Problem, clearance_m: float) -> Problem:
    return replace(problem, constraints=replace(problem.constraints, clearance_m=clearance_m))


def _is_open(problem: Problem) -> bool:
    try:
        build_scene(problem)
    except NoPlanError:
        return False
    return True
