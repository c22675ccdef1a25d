"""Task pursuit_design: mote networks of minimum power or energy that guarantee capture."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from pydantic import Field

from planopt.bounds.bound import relative_gap
from planopt.errors import InputError, NoPlanError
from planopt.files.tables import finite
from planopt.keys import SMALLEST, Length, Table
from planopt.planning.plan import Termination, Verdict
from planopt.problems.schema import TaskFile
from planopt.problems.tasks import TaskProblem
from planopt.pursuit.certificate import DesignData, Inequality, Theorem, certify
from planopt.pursuit.design import (
    MAX_BITS,
    Design,
    DesignTask,
    MoteNetwork,
    NoDesignError,
    cheapest_design,
    cheapest_rated_design,
    least_energy_design,
    pareto_front,
    relaxed_design,
    sensitivities,
    sharp_design,
)
from planopt.pursuit.guarantees import Chase, Guarantee
from planopt.pursuit.service import MOST_SIMULATED_LEVELS, late_shares
from planopt.tasks.task import Task, TaskResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FRONT_DESIGNS = 25  # A quarter of the number of deadlines tried for the Pareto front

PICTURE = "design.png"

REQUIREMENT_WORDS = {
    "payload of a slot below what it carries": "bits to send in a slot",
    "y = v_e period below 1": "y, movement of the evader between rounds",
    "a of the error over 1 - y below 1": "a, with the position error scaled by 1 / (1 - y)",
    "growth while waiting below 1": "growth of the distance during a wait",
    "floor below the capture radius": "guaranteed final distance",
    "time to capture below the deadline": "time to capture",
    "a + x below 1": "a + x",
    "a + x + margin below 1": "a + x + margin",
    "a + (1 - 1/alpha) x below 1": "a + (1 - evader speed / pursuer speed) x",
    "a below 1": "a",
}
"""Descriptions of the requirements' left sides in text; the keys are used in JSON."""

BINDING_WORDS = {
    "lemma": "the reduction of the distance (Lemma)",
    "payload": "the payload of a slot",
    "deadline": "the deadline",
    "capture_radius": "the capture radius",
}
"""Descriptions of the active constraints in text."""
SYMBOLS = {
    "a": "distance after a drive to a fresh report, divided by the distance before it",
    "x": "movement of the evader during the age of a report, divided by its distance",
    "y": "movement of the evader between rounds, divided by its distance",
}
"""Meanings of the symbols in descriptions of requirements."""
ACTIVE = 1e-6  # Margin, as a share of the limit, below which a requirement is shown as active
LEAST_EFFECT = 0.005  # Minimum effect of a listed parameter, in per cent

MethodName = Literal["least_power", "least_power_rated", "least_energy", "capture_in_time"]
TheoremName = Literal["lemma", "any_instant", "sampled_distance", "snapshots"]

SCAN_SHARE = 1e-9
"""Relative error of the optimum over numbers of bits: ten times the tolerance of bisection."""

REQUIREMENTS = ("first_distance_m", "capture_radius_m", "deadline_s")


@dataclass(frozen=True)
class Method:
    """Design method with its solver and keys."""

    words: str  # Description in text output
    solver: Callable[[Theorem], Callable[[DesignTask], Design]]  # Solver for a theorem
    needs: tuple[str, ...] = ()  # Mandatory keys; `takes` has the optional ones
    takes: tuple[str, ...] = ()
    of_energy: bool = False  # Whether the objective is energy per capture; otherwise power


METHODS: dict[MethodName, Method] = {
    "least_power": Method(
        "least power whose reports reduce the distance to the evader each time",
        lambda theorem: cheapest_design,
        takes=("first_distance_m",),
    ),
    "least_power_rated": Method(
        "least power, with rounds at a reduced rate",
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


class ChaseTable(Table):
    """Table ``[pursuit]``: requirements of the pursuit."""

    evader_speed_m_s: float = Field(ge=SMALLEST, le=1e4)
    """Largest speed of the evader in m/s."""
    pursuer_speed_m_s: float = Field(ge=SMALLEST, le=1e4)
    """Largest speed of the pursuer in m/s; above the evader's."""
    stage_delay_s: float = Field(default=0.0, ge=0, le=1e4)
    """Extra time of a stage in seconds beyond driving straight, such as turning and one step."""
    first_distance_m: Length | None = None
    """Distance in metres from the pursuer to the first sampled position of the evader."""
    capture_radius_m: Length | None = None
    """Distance in metres at which the evader is captured, for capture_in_time."""
    deadline_s: float | None = Field(default=None, ge=SMALLEST, le=1e9)
    """Deadline of the capture in seconds, for capture_in_time and least_energy."""


class DesignTable(Table):
    """Table ``[design]``: objective and guarantee."""

    method: MethodName = "least_power"
    """least_power, least_power_rated, least_energy (all by the Lemma), or capture_in_time."""
    guarantee: TheoremName | None = None
    """Theorem for capture_in_time: snapshots (the default), sampled_distance, any_instant or lemma.
    The other methods use the lemma."""
    margin: float = Field(default=0.01, ge=1e-12, lt=1)
    """Margin of a + x below 1 in the Lemma."""
    bits_per_axis: int | None = Field(default=None, ge=1, le=MAX_BITS)
    """Bits c per axis of a reported position; default: optimised."""


class DesignFile(TaskFile):
    """Problem file (TOML) of the task pursuit_design."""

    pursuit: ChaseTable
    network: MoteNetwork
    design: DesignTable = Field(default_factory=DesignTable)


@dataclass(frozen=True, eq=False, repr=False)
class DesignProblem(TaskProblem):
    """Problem of the task pursuit_design."""

    config: DesignFile
    design: DesignTask
    method: Method
    theorem: Theorem  # Theorem of the guarantee

    @property
    def solver(self) -> Callable[[DesignTask], Design]:
        """Return the solver of the design problem."""
        return self.method.solver(self.theorem)

    def objective(self, design: Design) -> float:
        """Return the minimised quantity of a design: energy per capture in J, or power in W."""
        return design.energy_per_capture_j if self.method.of_energy else design.cost_w

    def words(self) -> Sequence[str]:
        """Return a text summary of the problem, line by line."""
        chase, network = self.design.chase, self.design.network
        side = 2**network.levels
        return (
            f"{self.name}: {self.description}",
            f"  task        {self.task}: {self.method.words} (theorem '{self.theorem.value}')",
            f"  pursuit     speeds: evader {chase.evader_speed_m_s:g} m/s, pursuer "
            f"{chase.pursuer_speed_m_s:g} m/s",
            f"  network     {side} x {side} sensor nodes (motes), {network.mote_spacing_m:g} "
            f"m apart, {network.bit_rate_bit_s:g} bit/s, {network.slots_per_frame} slots per frame",
        )


def build(config: DesignFile, folder: Path, file: Path | None) -> DesignProblem:
    """Build the problem from validated tables."""
    pursuit, method = config.pursuit, METHODS[config.design.method]
    name = config.design.method
    for key in REQUIREMENTS:
        value = getattr(pursuit, key)
        if value is None and key in method.needs:
            raise InputError(
                "is missing",
                key=f"pursuit.{key}",
                remedy=f'design.method = "{name}" needs this key',
            )
        if value is not None and key not in (*method.needs, *method.takes):
            fitting = [each for each, other in METHODS.items() if key in other.needs + other.takes]
            raise InputError(
                f'is not used by design.method = "{name}"',
                key=f"pursuit.{key}",
                remedy=f"leave it out, or use the method {' or '.join(fitting)}",
            )
    if config.design.guarantee is not None and method is not METHODS["capture_in_time"]:
        raise InputError(
            f'cannot be chosen for design.method = "{name}", which always uses the lemma',
            key="design.guarantee",
            remedy='leave it out, or use design.method = "capture_in_time"',
        )
    timed = method is METHODS["capture_in_time"]
    theorem = Theorem(config.design.guarantee or ("snapshots" if timed else "lemma"))
    chase = Chase(pursuit.evader_speed_m_s, pursuit.pursuer_speed_m_s, pursuit.stage_delay_s)
    if not chase.slower_evader.holds:
        raise InputError(
            str(chase.slower_evader),
            key="pursuit.pursuer_speed_m_s",
            remedy="no network guarantees the capture of an evader as fast as its pursuer",
        )
    task = DesignTask(
        config.network,
        chase,
        config.design.margin,
        config.design.bits_per_axis,
        pursuit.first_distance_m,
        pursuit.capture_radius_m,
        pursuit.deadline_s,
    )
    return DesignProblem(config, file, task, method, theorem)


def solve(problem: DesignProblem, *, seed: int) -> TaskResult:
    """Return the network of minimum power or energy, its guarantee and active constraints."""
    design = problem.solver(problem.design)
    config = problem.config
    values = config.pursuit.model_dump() | config.network.model_dump()
    values["margin"] = config.design.margin
    values["slot_blocks"] = config.network.least_slot_blocks
    given = DesignData(**{key.name: values[key.name] for key in fields(DesignData)})
    # The independent verifier evaluates the requirements.
    proof = certify(
        given, problem.theorem, design.slot_width_s, design.rate_divisor, design.bits_per_axis
    )
    data = {
        "horizon": None,
        **_question(problem),
        **_design_json(problem, design, proof),
        "sensitivities": sensitivities(problem.design, problem.solver, problem.objective),
        "cost_curve": _cost_curve(problem),
        "pareto": [] if problem.design.first_distance_m is None else _front(problem),
    }
    return TaskResult(problem, data, value=design)


def _unproved(late: tuple[float, ...] | None, blocks: int) -> str:
    """Return the reason why records of a design may be late; empty if all are on time."""
    if late is None:
        return (
            f"a slot of {blocks} blocks is below the peak load, and sparse updates and grids of "
            f"more than {MOST_SIMULATED_LEVELS} levels are not simulated"
        )
    worst = int(np.argmax(late))
    if late[worst] == 0.0:
        return ""
    return (
        f"{100.0 * late[worst]:.3g} % of the level-{worst} records are late with slots of "
        f"{blocks} blocks, and the guarantee assumes none"
    )


def _question(problem: DesignProblem) -> dict[str, Any]:
    return {
        "planner": problem.config.design.method,
        "sense": "min",
        "objective_name": "energy_per_capture_j" if problem.method.of_energy else "cost_w",
    }


def _refusal(problem: DesignProblem, error: NoPlanError) -> dict[str, Any]:
    """Return the JSON keys of ``solve`` if no feasible network exists."""
    if not isinstance(error, NoDesignError):
        return _question(problem)
    nothing = dict.fromkeys(
        (
            *("objective", "bound", "gap", "bound_method"),
            *("slot_width_s", "rate_divisor", "bits_per_axis", "cost_w"),
        )
    )
    return {
        **_question(problem),
        **nothing,
        "termination": Termination.INFEASIBLE.value,
        "guarantee": None,
        "binding": [],
        "inequality": {**_inequality_json(error.inequality), "bits_per_axis": error.bits_per_axis},
        "cost_curve": _cost_curve(problem),
    }


def _design_json(
    problem: DesignProblem, design: Design, proof: tuple[Inequality, ...]
) -> dict[str, Any]:
    objective, lasts_s = problem.objective(design), _capture_time_s(problem, design)
    bound = objective * (1.0 - SCAN_SHARE)
    network = problem.design.network
    blocks = network.slot_capacity(design.slot_width_s, design.bits_per_axis)
    late = late_shares(
        network.levels,
        network.border_relays,
        blocks,
        design.rate_divisor,
        network.updates == "sparse",
    )
    reason = _unproved(late, blocks)
    verdict = Verdict.FEASIBLE_UNVERIFIED if reason else Verdict.VERIFIED
    if not all(each.holds for each in proof):
        verdict = Verdict.VIOLATED
    return {
        "termination": Termination.CONVERGED.value,
        "verdict": verdict.value,
        "objective": objective,
        "bound": bound,
        "gap": relative_gap(objective, bound, "min"),
        "bound_method": "the best slot width for every number of bits",
        "relaxed_cost_w": _relaxed_cost_w(problem),
        "slot_width_s": design.slot_width_s,
        "rate_divisor": design.rate_divisor,
        "bits_per_axis": design.bits_per_axis,
        "frame_s": design.slot_width_s * problem.design.network.slots_per_frame,
        "cost_w": design.cost_w,
        "capture_time_s": lasts_s,
        "energy_per_capture_j": None if lasts_s is None else design.cost_w * lasts_s,
        "binding": list(design.binding),
        "guarantee": _guarantee_json(problem, design.guarantees[problem.theorem]),
        "guarantees": {
            theorem.value: _guarantee_json(problem, each)
            for theorem, each in design.guarantees.items()
        },
        "certificate": {
            "requirements": [
                {
                    **_inequality_json(each),
                    "strict": each.strict,
                    "holds": each.holds,
                    "text": str(each),
                }
                for each in proof
            ],
            "slot_blocks": blocks,
            "late_share": None if late is None else list(late),
            "reasons": [reason] if reason else [],
        },
        "message": reason,
    }


def _relaxed_cost_w(problem: DesignProblem) -> float | None:
    """Return the least power in W with continuous compression; None if not available."""
    rated = problem.method is METHODS["least_power_rated"]
    if not rated and problem.method is not METHODS["least_power"]:
        return None
    bits = problem.design.bits_per_axis
    try:
        return relaxed_design(problem.design, rated=rated, bits_per_axis=bits).cost_w
    except NoPlanError:
        return None


def _capture_time_s(problem: DesignProblem, design: Design) -> float | None:
    """Return the upper bound of the capture time; None without a first distance."""
    first_m, radius_m = problem.design.first_distance_m, problem.design.capture_radius_m
    if first_m is None:
        return None
    if radius_m is None:
        return finite(design.capture_time_s)
    return finite(design.guarantees[problem.theorem].capture_time_s(first_m, radius_m))


def _guarantee_json(problem: DesignProblem, guarantee: Guarantee) -> dict[str, Any]:
    first_m, radius_m = problem.design.first_distance_m, problem.design.capture_radius_m
    lasts_s = math.inf
    if first_m is not None and radius_m is not None:
        lasts_s = guarantee.capture_time_s(first_m, radius_m)
    return {
        "theorem": guarantee.theorem.value,
        "holds": bool(guarantee.holds),
        "inequalities": [_inequality_json(each) for each in guarantee.inequalities],
        "ratio": finite(guarantee.ratio),
        "floor_m": finite(guarantee.floor_m),
        "capture_time_s": finite(lasts_s),
    }


def _inequality_json(inequality: Inequality) -> dict[str, Any]:
    return {
        "words": inequality.words,
        "left": finite(inequality.left),
        "right": finite(inequality.right),
        "unit": inequality.unit,
        "margin": finite(inequality.margin),
    }


def _cost_curve(problem: DesignProblem) -> list[dict[str, Any]]:
    """Return a row per number of bits: the best design, or the violated inequality."""
    rows: list[dict[str, Any]] = []
    for bits in problem.design.bits:
        row: dict[str, Any] = {"bits_per_axis": bits, "objective": None, "slot_width_s": None}
        try:
            design = problem.solver(replace(problem.design, bits_per_axis=bits))
        except NoDesignError as error:
            rows.append({**row, "fails": str(error.inequality)})
        else:
            found = {"objective": problem.objective(design), "slot_width_s": design.slot_width_s}
            rows.append({**row, **found, "fails": None})
    return rows


def _front(problem: DesignProblem) -> list[dict[str, Any]]:
    """Return the Pareto front of energy per capture against deadline."""
    task = replace(problem.design, deadline_s=None, capture_radius_m=None)
    try:
        slowest_s = least_energy_design(task).capture_time_s
    except NoDesignError:
        return []
    assert task.first_distance_m is not None
    # Driving straight to the first sampled position bounds the capture time from below.
    driving_s = task.first_distance_m / task.chase.pursuer_speed_m_s
    deadlines = np.geomspace(driving_s, slowest_s * (1.0 + 1e-9), FRONT_DESIGNS * 4)
    keys = "capture_time_s energy_per_capture_j cost_w slot_width_s bits_per_axis".split()
    front = pareto_front(task, deadlines.tolist())
    return [{key: getattr(design, key) for key in keys} for design in front]


def in_words(result: TaskResult) -> Sequence[str]:
    """Return a text summary of a design, line by line."""
    problem, data = cast("DesignProblem", result.problem), result.data
    names, divisor = cast("list[str]", data["binding"]), data["rate_divisor"]
    binding = " and ".join(BINDING_WORDS.get(name, name) for name in names)
    rounds = f"one round every {divisor} round lengths" if divisor > 1 else "rounds without pauses"
    lines = [
        f"{problem.name}: {data['verdict']}, {problem.method.words}",
        f"  power {data['cost_w']:.6g} W: TDMA slots of {1e3 * data['slot_width_s']:.4g} ms, "
        f"{data['bits_per_axis']} bits per coordinate, {rounds}",
        f"  active constraint: {binding or 'none (an interior optimum)'}",
    ]
    lines.append(f"  proven optimal by comparing {data['bound_method']}")
    if data["relaxed_cost_w"] is not None:
        lines.append(f"  lower bound with continuous bits {data['relaxed_cost_w']:.6g} W")
    if data["capture_time_s"] is not None:
        holds = "would be guaranteed" if data["message"] else "is guaranteed"
        lines.append(
            f"  capture {holds} within {data['capture_time_s']:.4g} s "
            f"(theorem '{problem.theorem.value}'"
            + (", if every report were on time)" if data["message"] else ")")
        )
    if data["energy_per_capture_j"] is not None and problem.method.of_energy:
        lines.append(f"  energy per capture at most {data['energy_per_capture_j']:.4g} J")
    blocks = data["certificate"]["slot_blocks"]
    lines += [f"  {line}" for line in _requirements_in_words(data["certificate"]["requirements"])]
    if data["message"]:
        lines.append(f"  not verified: {data['message']}")
    else:
        lines.append(f"  verified: every report is on time, as a slot has room for {blocks} blocks")
    effects = sorted(data["sensitivities"].items(), key=lambda item: -abs(item[1]))
    what = "energy" if problem.method.of_energy else "power"
    shown = ", ".join(
        f"{name} {value:+.2f} %" for name, value in effects if abs(value) >= LEAST_EFFECT
    )
    lines.append(f"  change of the {what} if one parameter increases by 1 %: {shown}")
    return lines


def _requirements_in_words(requirements: Sequence[dict[str, Any]]) -> list[str]:
    """Return the table of requirements with both sides of each inequality."""
    from planopt.report.tables import aligned

    def shown(value: float | None, unit: str) -> str:
        return "-" if value is None else f"{value:.4g} {unit}".strip()

    table = [["requirement (checked by the verifier)", "value", "upper limit", "margin", ""]]
    for each in requirements:
        sides = [shown(each[key], each["unit"]) for key in ("left", "right", "margin")]
        if each["margin"] is not None and 0.0 <= each["margin"] <= ACTIVE * abs(each["right"]):
            sides[2] = "none"
        words = str(REQUIREMENT_WORDS.get(each["words"], each["words"]))
        table.append([words, *sides, "" if each["holds"] else "violated"])
    lines = aligned(table, 1)
    used = {s for s in SYMBOLS if any(re.search(rf"(^|\+ |\) ){s}\b", row[0]) for row in table)}
    return [f"{s}: {SYMBOLS[s]}" for s in sorted(used)] + lines


def _figures(result: TaskResult) -> dict[str, Figure]:
    from planopt.report import draw_design

    problem = cast("DesignProblem", result.problem)
    return {PICTURE: draw_design(problem.design, result.data)}


TASK = Task(
    model=DesignFile,
    build=build,
    solve=solve,
    summary=in_words,
    refusal=_refusal,
    figures=_figures,
    pictures=(PICTURE,),
)
