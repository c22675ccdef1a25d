"""What a plan misses, at which steps and by how much, as the verifier found it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.planning.explain.case import Case
from planopt.planning.explain.reach_limits import best_margin_db
from planopt.planning.history import BEGINNING
from planopt.planning.proof.rules.asked import is_priced
from planopt.planning.proof.rules.proven import asked_steps
from planopt.planning.proof.rules.tolerance import is_missed
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M, MARGIN_TOLERANCE_DB
from planopt.planning.worth.rules.planned import planned_rule
from planopt.robots.braked_motion import braked_motion
from planopt.world.least_distance import step_distances_m

Missed = Literal["connection", "separation", "moving"]


@dataclass(frozen=True)
class Fault:
    """A constraint that a plan does not keep.

    Attributes
    ----------
    missed
        The connection, the distance of other robots, or that of moving obstacles.
    stages
        Steps (1 is the first) that it is about.
    shortfall, unit
        By how much it is missed; the unit is empty for a probability.
    """

    missed: Missed
    stages: tuple[int, ...]
    shortfall: float
    unit: str


def faults_of(case: Case) -> tuple[Fault, ...]:
    """Everything that the plan misses; empty where it is only the motion."""
    connection = _connection(case)
    found = [] if connection is None else [connection]
    return (*found, *_distances(case))


def met_nowhere(case: Case) -> bool:
    """Whether single steps are asked for, may be missed, and all are."""
    rule = case.problem.constraints.rule
    steps = len(case.plan.positions_m) - 1
    missed = case.plan.certificate.relaxed_steps
    asked = asked_steps(case.own, BEGINNING, steps)
    return rule.by_step and rule.slack_max_db is None and 0 < len(missed) == int(asked.sum())


def _connection(case: Case) -> Fault | None:
    problem, certificate = case.own, case.plan.certificate
    rule, result = problem.constraints.rule, certificate.rule
    if not rule.by_step:
        if result is None or result.slack_db > 0.0 or not is_missed(result):
            return None
        unit = "" if result.unit == "probability" else result.unit
        return Fault(
            "connection",
            _stages(planned_rule(rule).weak_steps(problem, case.plan)),
            result.missing,
            unit,
        )
    limit = rule.slack_max_db or 0.0
    missed = [
        (step, missing - limit)
        for step, missing in zip(certificate.relaxed_steps, certificate.relaxation_db, strict=True)
        if missing > limit + MARGIN_TOLERANCE_DB
    ]
    if not missed:
        return None
    stages = tuple(step for step, _ in missed)
    short_db = max(missing for _, missing in missed)
    if met_nowhere(case) or is_priced(problem):
        # The limit of what any plan could keep, unless that is not what is in the way.
        best_db = best_margin_db(problem, case.posteriors)
        short_db = -best_db if best_db < 0.0 else short_db
    elif rule.slack_max_db is None and max(certificate.best_margin_db) < 0.0:
        return None  # nothing within reach keeps these steps, which excuses them
    return Fault("connection", stages, short_db, "dB")


def _distances(case: Case) -> list[Fault]:
    """Distances at equal times that are not kept, of robots and of moving obstacles.

    What is not kept while robots stop after the last step counts as of the last.
    """
    discs, planned = case.moving, len(case.plan.positions_m) - 1
    motion = braked_motion(case.plan.positions_m, case.plan.drive, case.problem.planner.step_s)
    away = np.full((len(discs), planned), np.inf)
    for number in range(len(discs)):
        count = discs.counted_steps(number, motion)
        gaps = step_distances_m(motion, discs.motion(number), count)
        gaps -= discs.radius_m[number, :count] + discs.least_m[number]
        np.minimum.at(away[number], np.minimum(np.arange(count), planned - 1), gaps)
    found: list[Fault] = []
    kinds: list[tuple[Missed, NDArray[np.bool_]]] = [
        ("separation", discs.is_robot),
        ("moving", ~discs.is_robot),
    ]
    for missed, which in kinds:
        if not which.any():
            continue
        least = away[which].min(axis=0)
        if least.min() < -CLEARANCE_TOLERANCE_M:
            stages = _stages(least < -CLEARANCE_TOLERANCE_M)
            found.append(Fault(missed, stages, float(-least.min()), "m"))
    return found


def _stages(which: NDArray[np.bool_]) -> tuple[int, ...]:
    return tuple((np.flatnonzero(which) + 1).tolist())
