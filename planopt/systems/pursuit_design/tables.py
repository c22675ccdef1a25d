"""Problem files of the task pursuit_design, and the ways to design a network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, cast

from pydantic import Field

from planopt.errors import InputError
from planopt.problems.settings import ReportSettings
from planopt.problems.tables import SMALLEST, Metres, Name, Table
from planopt.pursuit.design import (
    MAX_BITS,
    Design,
    DesignTask,
    cheapest_design,
    cheapest_rated_design,
    least_energy_design,
    sharp_design,
)
from planopt.pursuit.guarantees import Chase
from planopt.pursuit.network import MoteNetwork
from planopt.pursuit.service import MAX_LEVELS, slots_per_frame
from planopt.pursuit.theorems import Theorem

MethodName = Literal["least_power", "least_power_rated", "least_energy", "capture_in_time"]
TheoremName = Literal["lemma", "any_instant", "sampled_distance", "snapshots"]

REQUIREMENTS = ("first_distance_m", "capture_radius_m", "deadline_s")


@dataclass(frozen=True)
class Method:
    """A way to design a network."""

    words: str  # For people
    solver: Callable[[Theorem], Callable[[DesignTask], Design]]  # Gives the solver for a theorem
    needs: tuple[str, ...] = ()  # Requirements that must be, and others that may be given
    takes: tuple[str, ...] = ()
    of_energy: bool = False  # Whether it minimises energy per capture, else power


METHODS: dict[MethodName, Method] = {
    "least_power": Method(
        "least power for which every stage shrinks the distance",
        lambda theorem: cheapest_design,
        takes=("first_distance_m",),
    ),
    "least_power_rated": Method(
        "least power, rounds of all levels every r-th time",
        lambda theorem: cheapest_rated_design,
        takes=("first_distance_m",),
    ),
    "least_energy": Method(
        "least energy per capture",
        lambda theorem: least_energy_design,
        needs=("first_distance_m",),
        takes=("deadline_s",),
        of_energy=True,
    ),
    "capture_in_time": Method(
        "least power that guarantees capture by the deadline",
        lambda theorem: partial(sharp_design, theorem=theorem),
        needs=REQUIREMENTS,
    ),
}


class HeadTable(Table):
    """``[problem]``: what the problem is called and what it asks."""

    schema_version: Literal[1] = Field(
        alias="schema", description="Version of this schema; it is 1."
    )
    name: Name = Field(description="Name: letters, digits, '_' and '-'.")
    task: Literal["pursuit_design"] = Field(description="pursuit_design.")
    description: str = Field(default="", description="One sentence for people.")


class ChaseTable(Table):
    """``[pursuit]``: the pursuit that the network is to serve."""

    evader_speed_m_s: float = Field(
        ge=SMALLEST, le=1e4, description="Largest speed of the evader in m/s."
    )
    pursuer_speed_m_s: float = Field(
        ge=SMALLEST, le=1e4, description="Largest speed of the pursuer in m/s; above the evader's."
    )
    stage_delay_s: float = Field(
        default=0.0,
        ge=0,
        le=1e4,
        description="Seconds that a stage may take beyond driving straight: turning, one step.",
    )
    first_distance_m: Metres | None = Field(
        default=None,
        ge=SMALLEST,
        description="From the pursuer to where the evader is sampled first.",
    )
    capture_radius_m: Metres | None = Field(
        default=None, ge=SMALLEST, description="An evader so near is caught, for capture_in_time."
    )
    deadline_s: float | None = Field(
        default=None,
        ge=SMALLEST,
        le=1e9,
        description="Seconds by when it is to be caught, for capture_in_time and least_energy.",
    )


class NetworkTable(Table):
    """``[network]``: motes and their radios."""

    levels: int = Field(ge=1, le=MAX_LEVELS, description="L: there are 4^L motes.")
    mote_spacing_m: Metres = Field(ge=SMALLEST, description="Metres between neighbours.")
    bit_rate_bit_s: float = Field(
        ge=SMALLEST, le=1e15, description="What a slot carries, in bit/s."
    )
    header_bits: float = Field(ge=0, le=1e9, description="Bits of a frame beside its blocks.")
    record_bits: float = Field(ge=0, le=1e9, description="Bits of a block beside the position.")
    energy_j_per_bit: float = Field(
        ge=1e-15, le=1e6, description="What a sent bit costs, with those who hear it, in J."
    )
    idle_w: float = Field(default=0.0, ge=0, le=1e6, description="What a mote draws all the time.")
    slots_per_frame: int = Field(
        default=slots_per_frame(),
        ge=slots_per_frame(),
        le=10_000,
        description="Slots of a TDMA frame.",
    )
    slot_blocks: int = Field(
        default=6,
        ge=1,
        le=10_000,
        description="Blocks that a slot must carry: 6 for the mean load, more for the peak.",
    )
    border_relays: bool = Field(
        default=True, description="Whether motes at the border of nine cells send records on."
    )


class DesignTable(Table):
    """``[design]``: what is minimised, and under which guarantee."""

    method: MethodName = Field(
        default="least_power",
        description="least_power, least_power_rated, least_energy (all by the Lemma), or "
        "capture_in_time.",
    )
    guarantee: TheoremName | None = Field(
        default=None,
        description="Theorem for capture_in_time: snapshots (the default), sampled_distance, "
        "any_instant or lemma. The other methods rest on the lemma.",
    )
    margin: float = Field(
        default=0.01, ge=1e-12, lt=1, description="By how much a + x stays below 1 in the Lemma."
    )
    bits_per_axis: int | None = Field(
        default=None, ge=1, le=MAX_BITS, description="Bits c of a position; left out: chosen."
    )


class ReportTable(Table):
    """``[report]``: what is drawn."""

    figures: bool = Field(
        default=ReportSettings().figures, description="Draw the pictures (true or false)."
    )


class DesignFile(Table):
    """A planopt problem file (TOML) of the task pursuit_design."""

    problem: HeadTable
    pursuit: ChaseTable
    network: NetworkTable
    design: DesignTable = Field(default_factory=DesignTable)
    report: ReportTable = Field(default_factory=ReportTable)


@dataclass(frozen=True)
class DesignProblem:
    """A network to design."""

    task: DesignTask  # What is asked for, how, and what the guarantee rests on
    method: Method
    theorem: Theorem
    figures: bool  # Whether pictures are drawn

    @property
    def solver(self) -> Callable[[DesignTask], Design]:
        """Return the solver of the design."""
        return self.method.solver(self.theorem)

    def worth(self, design: Design) -> float:
        """Return what is minimised: J per capture, or W."""
        return design.energy_per_capture_j if self.method.of_energy else design.cost_w


def build(given: DesignFile, folder: Path) -> DesignProblem:
    """Return the problem in validated tables."""
    pursuit, method = given.pursuit, METHODS[given.design.method]
    name = given.design.method
    for key in REQUIREMENTS:
        value = getattr(pursuit, key)
        if value is None and key in method.needs:
            raise InputError("is missing", key=f"pursuit.{key}", remedy=f"{name} needs it")
        if value is not None and key not in (*method.needs, *method.takes):
            fitting = [each for each, other in METHODS.items() if key in other.needs + other.takes]
            raise InputError(
                f"is given, which {name} does not look at",
                key=f"pursuit.{key}",
                remedy=f"leave it out, or use design.method {' or '.join(fitting)}",
            )
    if given.design.guarantee is not None and method is not METHODS["capture_in_time"]:
        raise InputError(
            f"is given, and {name} rests on the lemma",
            key="design.guarantee",
            remedy="leave it out, or use design.method capture_in_time",
        )
    timed = method is METHODS["capture_in_time"]
    theorem = Theorem(given.design.guarantee or ("snapshots" if timed else "lemma"))
    try:
        chase = Chase(pursuit.evader_speed_m_s, pursuit.pursuer_speed_m_s, pursuit.stage_delay_s)
    except InputError as error:
        raise InputError(error.message, key=f"pursuit.{error.key}", remedy=error.remedy) from None
    task = DesignTask(
        MoteNetwork(**cast("dict[str, float]", given.network.model_dump())),  # pyright: ignore[reportArgumentType]
        chase,
        given.design.margin,
        given.design.bits_per_axis,
        pursuit.first_distance_m,
        pursuit.capture_radius_m,
        pursuit.deadline_s,
    )
    return DesignProblem(task, method, theorem, given.report.figures)
