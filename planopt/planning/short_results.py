"""Short texts of solutions and runs, of one robot or several: what ``print`` shows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np

from planopt.errors import InputError
from planopt.planning.loop.log import RobotRun
from planopt.planning.plan import Plan
from planopt.problems.problem import Problem
from planopt.short_repr import LINES, wrapped

Kind = TypeVar("Kind")


def short_solution(problem: Problem, seed: int, plans: Sequence[Plan]) -> str:
    """Return a line for the problem and one for each plan, five lines at most."""
    horizon = len(plans[0].t_s) - 1
    head = f"solution of {problem.name}, horizon {horizon}, seed {seed}"
    lines: list[str] = []
    for plan in plans:
        clearance = plan.certificate.min_clearance_m
        lines.append(
            f"{plan.robot}: {plan.verdict.value} ({plan.rung.value}, {plan.termination.value}), "
            f"objective {plan.objective:.4g}, "
            + (f"clearance {clearance:.4g} m, " if math.isfinite(clearance) else "")
            + f"least P(connected) {np.min(plan.connectivity[1:], initial=1.0):.4f}"
        )
    return _listed(head, lines, most=LINES - 1)


def short_run(
    problem: Problem, seed: int, runs: Sequence[RobotRun], metrics: Mapping[str, float]
) -> str:
    """Return a line for the problem, two for how robots ended, and two for the metrics at most."""
    head = f"run of {problem.name}, horizon {problem.planner.horizon}, seed {seed}"
    lines = [
        f"{run.robot}: {run.outcome.value} after {len(run.log.t_s) - 1} steps ({run.reason}), "
        + (f"{run.verified_rate:.1%} of the steps verified" if run.rungs else "no step was driven")
        for run in runs
    ]
    shown = ", ".join(f"{name} {value:.4g}" for name, value in metrics.items())
    return "\n".join([_listed(head, lines, most=LINES - 3), wrapped(f"  {shown}", 2)])


def only(several: Sequence[Kind], name: str) -> Kind:
    """Return the only one of `several`."""
    if len(several) != 1:
        raise InputError(f"there are {len(several)} robots", remedy=f"use {name}, one of each")
    return several[0]


def _listed(head: str, lines: Sequence[str], most: int) -> str:
    """Return `head` and `lines` below it; of more than `most` the first, and how many more."""
    if len(lines) > most:
        lines = [*lines[: most - 1], f"and {len(lines) - most + 1} more robots"]
    return "\n".join([head, *(f"  {line}" for line in lines)])
