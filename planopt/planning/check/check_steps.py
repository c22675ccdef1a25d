"""Judge ``steps.csv``: every cell against the one that the rest of the files gives.

Its names that stand for something must be those that planopt gives.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum

from planopt.planning.check.agreement import SHOWN_ALIKE, Disagreement, disagreements
from planopt.planning.files.run_json import ReleasedRecord, RunRecord
from planopt.planning.files.solution_json import PlanRecord, RobotPlanRecord
from planopt.planning.files.steps_file import STEPS_FILE, Steps
from planopt.planning.loop.log import Outcome
from planopt.planning.plan import Rung, Termination, Verdict


def steps_reasons(said: Steps, found: Steps) -> list[str]:
    """Return what in the table is not as found, by row and column; few rows of each column."""
    reasons: list[str] = []
    for name in said.columns:
        if name == "step":  # was counted when it was read
            continue
        alike = list(_column_differences(name, said, found))
        for row, difference in alike[:SHOWN_ALIKE]:
            reasons.append(
                f"{STEPS_FILE}, row {row + 2}, step {said.steps[row]}: {name} is "
                f"{difference.said}, found {difference.found}"
            )
        if len(alike) > SHOWN_ALIKE:
            reasons.append(f"{STEPS_FILE}: {name} differs in {len(alike) - SHOWN_ALIKE} more rows")
    return reasons


def _column_differences(name: str, said: Steps, found: Steps) -> Iterator[tuple[int, Disagreement]]:
    rows = zip(_column(said, name), _column(found, name), strict=True)
    for row, (one, other) in enumerate(rows):
        for difference in disagreements(one, other, name, name):
            yield row, difference


def _column(steps: Steps, name: str) -> list[float] | list[str]:
    if name == "robot":
        return list(steps.robots)
    if name in steps.labels:
        return list(steps.labels[name])
    return {**steps.numbers, **steps.motion}[name].tolist()


_PlanLabels = RobotPlanRecord | ReleasedRecord


def label_reasons(file: str, record: PlanRecord | RunRecord) -> list[str]:
    """Return a reason for every unknown termination, verdict, fallback and outcome."""
    unknown: list[str] = []
    if isinstance(record, RunRecord):
        unknown += _unknown("outcome", record.outcome, Outcome)
    for prefix, plan in _plans(record):
        unknown += _of_plan(plan, prefix)
    return [f"{file}, key {text}" for text in unknown]


def _plans(record: PlanRecord | RunRecord) -> Iterator[tuple[str, _PlanLabels]]:
    """Every plan of a record, with what to put before its keys."""
    if isinstance(record, PlanRecord):
        for number, robot in enumerate(record.robots):
            yield f"robots[{number}].", robot
        return
    for number, robot in enumerate(record.plans):
        for step, plan in enumerate(robot.released):
            yield f"plans[{number}].released[{step}].", plan


def _of_plan(record: _PlanLabels, prefix: str) -> Iterator[str]:
    yield from _unknown(f"{prefix}termination", record.termination, Termination)
    yield from _unknown(f"{prefix}verdict", record.verdict, Verdict)
    yield from _unknown(f"{prefix}rung", record.rung, Rung)


def _unknown(key: str, name: str, known: type[StrEnum]) -> Iterator[str]:
    if name not in set(known):
        yield f'{key}: "{name}", should be one of {", ".join(known)}'
