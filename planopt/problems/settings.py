"""Settings of a problem: target, planner, report, and what a comparison runs."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, cast

from pydantic import AfterValidator, BeforeValidator, Field, Strict
from pydantic_core import PydanticCustomError

from planopt.errors import InputError
from planopt.keys import Name, Pair, Part
from planopt.parts import parts_of
from planopt.problems.planner_kinds import OWN, planner_names

MIN_HORIZON, MAX_HORIZON = 1, 500

Coordination = Literal["joint", "decoupled"]


def known_planner(name: str) -> str:
    """Refuse the name of a planner that does not exist, in words of the schema."""
    known = planner_names()
    if name not in known:
        listed = ", ".join(f"'{each}'" for each in known[:-1])
        raise PydanticCustomError(
            "planner_name", "Input should be {names}", {"names": f"{listed} or '{known[-1]}'"}
        )
    return name


@dataclass(frozen=True, kw_only=True)
class PlannerSettings(Part):
    """The settings of the planner."""

    at = "planner"

    step_s: Annotated[float, Field(gt=0, le=1e4)]
    """Duration of a step in seconds."""
    name: Annotated[
        str,
        AfterValidator(known_planner),
        Field(
            examples=list(OWN),
            description="nlp (lattice, polish by IPOPT, verify), scp (polish by sequential convex "
            "programming), auto (the better of them, nlp), lattice (no polish), and for tasks "
            "other than reach a baseline: "
            f"{', '.join(name for name, kind in OWN.items() if not kind.reaches_goals)}; or a "
            "planner that is registered.",
        ),
    ] = "auto"
    horizon: Annotated[int, Field(ge=MIN_HORIZON, le=MAX_HORIZON)] = 10
    """Steps ahead (N)."""
    neighbours: Annotated[int, Field(ge=4, le=512)] = 48
    """Measurements that the solver conditions each stage on (a number)."""
    max_steps: Annotated[int, Field(ge=1, le=100_000)] = 400
    """A closed loop that has not arrived after this many steps ends."""
    budget_s: Annotated[float | None, Field(gt=0, le=1e6)] = None
    """Seconds that a plan should take: the last polish begins, and ends, early enough for its
    proof; left out: no limit."""
    coordination: Coordination = "joint"
    """For several robots: joint (each knows what the others plan to measure, and counts what it
    adds) or decoupled (each counts as if it were alone)."""
    rounds: Annotated[int, Field(ge=1, le=10)] = 1
    """How often the robots of a joint team plan in one step, in turn (a number); later rounds take
    time, and never lessen the team's objective."""


@dataclass(frozen=True)
class ReportSettings(Part):
    """The settings of the report."""

    at = "report"

    figures: bool = True
    """Draw the pictures (true or false)."""


Packets = Literal["measurements", "estimates"]
"""What a packet to the station has of the target."""

LEAST_STD = 1e-6
"""Of a first estimate in metres or m/s: its information is still a number that can be inverted."""


@dataclass(frozen=True, kw_only=True)
class Target(Part):
    """A moving target and what is known of it at the start (equation 4.7)."""

    at = "targets[]"

    name: Name = "target"
    """What outputs call it."""
    start_m: Pair
    """Where it truly starts, [x, y] in metres."""
    velocity_m_s: Pair
    """Its true velocity at the start, [x, y] in m/s."""
    acceleration_std_m_s2: Annotated[float, Field(ge=0, le=1e6)] = 0.03
    """Deviation of its white acceleration along an axis, in m/s^2."""
    position_std_m: Annotated[float, Field(ge=LEAST_STD, le=1e6)] = 1.0
    """Deviation of its first estimated position, in m."""
    velocity_std_m_s: Annotated[float, Field(ge=LEAST_STD, le=1e6)] = 0.3
    """Deviation of its first estimated velocity, in m/s."""
    start_distance_m: Annotated[float | None, Field(ge=0, le=1e6)] = None
    """Where given, it starts so many metres from start_m in a direction drawn with the random seed,
    and moves away from there at the speed of velocity_m_s."""
    heading_spread_rad: Annotated[float, Field(ge=0, le=3.2)] = 0.0
    """Its first heading is then off that direction by up to so many rad."""
    stays_free: bool = False
    """Draw its path again until it stays within the bounds and out of obstacles (true or false)."""
    packets: Packets = "measurements"
    """measurements (a packet has the robot's last measurement of the target) or estimates (it has
    the robot's own estimate: the station then knows all that the robot has measured)."""
    packet_delay_steps: Annotated[int, Field(ge=0, le=1000)] = 0
    """The station has a packet so many steps after it is sent."""


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
