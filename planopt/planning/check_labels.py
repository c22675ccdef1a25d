"""Names in a saved file that stand for something must be those that planopt gives."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum

from planopt.planning.plan import Rung, Termination, Verdict
from planopt.planning.run import Outcome
from planopt.planning.run_json import ReleasedRecord, RunRecord
from planopt.planning.solution_json import PlanRecord


def label_reasons(file: str, record: PlanRecord | RunRecord) -> list[str]:
    """A reason for every unknown termination, verdict, rung and outcome."""
    if isinstance(record, PlanRecord):
        unknown = list(_of_plan(record, ""))
    else:
        unknown = list(_unknown("outcome", record.outcome, Outcome))
        for number, plan in enumerate(record.plans):
            unknown += _of_plan(plan, f"plans[{number}].")
    return [f"{file}, key {text}" for text in unknown]


def _of_plan(record: PlanRecord | ReleasedRecord, prefix: str) -> Iterator[str]:
    yield from _unknown(f"{prefix}termination", record.termination, Termination)
    yield from _unknown(f"{prefix}verdict", record.verdict, Verdict)
    yield from _unknown(f"{prefix}rung", record.rung, Rung)


def _unknown(key: str, name: str, known: type[StrEnum]) -> Iterator[str]:
    if name not in set(known):
        yield f'{key}: "{name}", should be one of {", ".join(known)}'
