"""What would give a verified plan, as saved plans have it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from planopt.planning.explain.explanation import Relaxation


class RelaxationRecord(BaseModel):
    """One change by which there would be a verified plan."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, frozen=True, extra="forbid")

    constraint: str
    unit: str
    value: float | None
    stages: list[int]
    shortfall: float | None = Field(ge=0)
    shortfall_unit: str
    relaxed_value: float | None
    verified: bool
    robot: str


def explanation_json(relaxations: Iterable[Relaxation]) -> list[dict[str, Any]]:
    """Every change as a table."""
    return [
        {
            "robot": one.robot,
            "constraint": one.constraint,
            "unit": one.unit,
            "value": one.value,
            "stages": list(one.stages),
            "shortfall": one.shortfall,
            "shortfall_unit": one.shortfall_unit,
            "relaxed_value": one.relaxed_value,
            "verified": one.verified,
        }
        for one in relaxations
    ]


def explanation_again(records: Iterable[RelaxationRecord]) -> tuple[Relaxation, ...]:
    """What :func:`explanation_json` wrote."""
    return tuple(
        Relaxation(
            one.constraint,
            one.unit,
            one.value,
            tuple(one.stages),
            one.shortfall,
            one.shortfall_unit,
            one.relaxed_value,
            one.verified,
            one.robot,
        )
        for one in records
    )
