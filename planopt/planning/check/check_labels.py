"""Names in a saved file that stand for something must be those that planopt gives."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum

from planopt.planning.files.run_json import PlannedRecord, RunRecord
from planopt.planning.files.solution_json import PlanRecord
from planopt.planning.files.team_run_json import TeamRunRecord
from planopt.planning.files.team_solution_json import RobotPlanRecord, TeamPlanRecord
from planopt.planning.loop.run import Outcome
from planopt.planning.plan import Rung, Termination, Verdict

_PlanLabels = PlanRecord | PlannedRecord | RobotPlanRecord


def label_reasons(
    file: str, record: PlanRecord | RunRecord | TeamPlanRecord | TeamRunRecord
) -> list[str]:
    """A reason for every unknown termination, verdict, rung and outcome."""
    unknown: list[str] = []
    if isinstance(record, RunRecord | TeamRunRecord):
        unknown += _unknown("outcome", record.outcome, Outcome)
    for prefix, plan in _plans(record):
        unknown += _of_plan(plan, prefix)
    return [f"{file}, key {text}" for text in unknown]


def _plans(
    record: PlanRecord | RunRecord | TeamPlanRecord | TeamRunRecord,
) -> Iterator[tuple[str, _PlanLabels]]:
    """Every plan of a record, with what to put before its keys."""
    match record:
        case PlanRecord():
            yield "", record
        case RunRecord():
            for number, plan in enumerate(record.plans):
                yield f"plans[{number}].", plan
        case TeamPlanRecord():
            for number, robot in enumerate(record.robots):
                yield f"robots[{number}].", robot
        case TeamRunRecord():
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
