"""The default settings and seeds of a comparison of a problem."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, cast

from pydantic import BeforeValidator, Field, Strict
from pydantic_core import PydanticCustomError

from planopt.errors import InputError
from planopt.parts import parts_of
from planopt.problems.tables import Part

DEFAULT_SEEDS, MOST_SEEDS = 30, 1_000_000
"""Where neither the command nor the problem says anything else, and at most."""

OF_NO_RUN = ("compare", "problem", "report")
"""Tables of a problem file that cannot be swept: who reads a run looks there for what it was."""


def known_seeds(given: object) -> object:
    """Refuse what is no number of seeds and no range of them, in words of the schema."""
    is_text = isinstance(given, str) and ":" in given
    if is_text or (isinstance(given, int) and not isinstance(given, bool)):
        with contextlib.suppress(InputError):
            if len(seeds_of(cast("str | int", given))) <= MOST_SEEDS:
                return given
    raise PydanticCustomError(
        "seeds",
        "should be a number of seeds from 1 to {most} or a range with a colon",
        {"most": f"{MOST_SEEDS:_}".replace("_", ",")},
    )


def require_swept(key: str, at: str | None = None) -> None:
    """Raise an error for a key of a problem file that cannot be swept."""
    table = key.partition(".")[0].partition("[")[0]
    if table in OF_NO_RUN:
        raise InputError(
            f"{key} cannot be swept",
            key=key if at is None else at,
            remedy="sweep a key that plans depend on, such as constraints.p_min; seeds have a key "
            "of their own",
        )


@dataclass(frozen=True, kw_only=True)
class SettingGroup(Part):
    """Settings of a comparison: the product of all lists."""

    at = "compare.settings[]"

    # In place of the problem's own, which are kept where there is none
    horizons: Annotated[tuple[int, ...], Strict(False)] = ()
    """Steps ahead; left out: the problem's own."""
    planners: Annotated[tuple[str, ...], Strict(False)] = ()
    """Names of planners; left out: the problem's own."""
    costs_to_go: Annotated[tuple[str, ...], Strict(False)] = ()
    """geodesic, connected; left out: both where there is a goal."""
    # Values of further keys of the problem file, by dotted key
    sweep: Mapping[str, Annotated[list[Any], Field(min_length=1)]] | None = field(
        default=None, hash=False
    )
    """Values of any keys of this file, such as { "constraints.p_min" = [0.5, 0.8] }."""


@dataclass(frozen=True, kw_only=True)
class ComparisonSettings(Part):
    """The settings of ``planopt compare`` where it is given none."""

    at = "compare"

    # How many random seeds, or a range such as 100:120, its end left out
    seeds: Annotated[
        Annotated[int, Field(ge=1, le=MOST_SEEDS)]
        | Annotated[str, Field(pattern=r"^\d{1,9}:\d{1,9}$")],
        BeforeValidator(known_seeds),
    ] = DEFAULT_SEEDS
    """How many random seeds (30: 0 to 29), or "100:120" (100 to 119)."""
    # Groups of settings, which stand one after the other; the first setting of the first group is
    # what others are paired with
    settings: Annotated[
        tuple[SettingGroup, ...], Strict(False), Field(min_length=1, max_length=100)
    ]
    """Groups of settings, one after the other; the first setting is what the others are paired
    with."""

    def __post_init__(self) -> None:
        remedy = "give groups, [SettingGroup(horizons=[1, 10])]"
        groups = parts_of("compare.settings", cast("object", self.settings), SettingGroup, remedy)
        object.__setattr__(self, "settings", groups)
        super().__post_init__()

    def fault(self) -> str | None:
        """Refuse a key that cannot be swept."""
        for number, group in enumerate(self.settings):
            for key in group.sweep or {}:
                require_swept(key, f"compare.settings[{number}].sweep")
        return None


def seeds_of(text: str | int, key: str = "seeds") -> range:
    """Return the seeds of a number of them, or of a range such as ``100:200``, its end left out."""
    begin, colon, end = str(text).partition(":")
    try:
        chosen = range(int(begin), int(end)) if colon else range(int(begin))
    except ValueError:
        chosen = range(0)
    if len(chosen) == 0 or chosen[0] < 0:
        raise InputError(f"cannot take {text!r}", key=key, remedy="a number such as 30, or 100:200")
    return chosen
