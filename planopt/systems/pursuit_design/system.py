"""Solve, print, draw and check the design of a network that serves a pursuit."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from planopt.errors import InputError, NoPlanError
from planopt.files.compare import differences, in_words
from planopt.planning.files.record import finite
from planopt.planning.plan import Termination, Verdict
from planopt.problems.systems import Answer, Request, System, SystemProblem
from planopt.pursuit.certificate import DesignData, Requirement, certify
from planopt.pursuit.design import (
    MAX_BITS,
    Design,
    NoDesignError,
    least_energy_design,
    pareto_front,
    sensitivities,
)
from planopt.pursuit.guarantees import Guarantee
from planopt.pursuit.programmes import relaxed_design
from planopt.pursuit.theorems import Inequality
from planopt.systems.pursuit_design.tables import METHODS, DesignFile, DesignProblem, build

FRONT_DESIGNS = 25
"""Deadlines of the Pareto front."""

PICTURE = "design.png"
NO_PLAN, NOT_VERIFIED = 4, 3


def solve(problem: SystemProblem, request: Request) -> Answer:
    """Return the network of least power or energy, with what it promises and what binds."""
    if request.horizons or request.planners:
        raise InputError(
            "a design has neither a horizon nor a planner",
            key="--horizon" if request.horizons else "--planner",
            remedy="leave it out",
        )
    content: DesignProblem = problem.content
    began = time.perf_counter()
    try:
        design = content.solver(content.task)
    except NoDesignError as error:
        data = {**_common(problem, request.seed), **_without(content, error)}
        data["wall_s"] = time.perf_counter() - began
        words = (f"{problem.name}: no plan: {error}",)
        return Answer(None, data, words, NO_PLAN, failure=error)
    proof = _proof(content, design.slot_width_s, design.rate_divisor, design.bits_per_axis)
    data = {
        **_common(problem, request.seed),
        **_design_json(content, design, proof),
        **_chart_json(content),
    }
    data["wall_s"] = time.perf_counter() - began
    verified = all(each.holds for each in proof)
    return Answer(
        design,
        data,
        _in_words(problem, data, proof),
        0 if verified else NOT_VERIFIED,
        draw=(lambda folder: _draw(content, data, folder)) if content.figures else None,
    )


def check(file: Path, data: Mapping[str, Any], problem: SystemProblem) -> list[str]:
    """Return what is wrong with a saved design: certified from its numbers, then compared."""
    content: DesignProblem = problem.content
    if data.get("verdict") == Verdict.NONE.value:
        return [f"there is no design to judge: {data.get('message')}"]
    reasons: list[str] = []
    numbers = [data.get(key) for key in ("slot_width_s", "rate_divisor", "bits_per_axis")]
    slot, divisor, bits = numbers
    if (
        not isinstance(slot, float)
        or not isinstance(divisor, int)
        or not isinstance(bits, int)
        or not (0.0 < slot < math.inf and divisor >= 1 and 1 <= bits <= MAX_BITS)
    ):
        return [f"{file.name}, key slot_width_s: {numbers!r} are no design"]
    for each in _proof(content, slot, divisor, bits):
        if not each.holds:
            reasons.append(f"{file.name}: {each}")
    cost_w = content.task.network.power_w(slot, bits, divisor)
    if not math.isclose(cost_w, _number(data.get("cost_w")), rel_tol=1e-6):
        reasons.append(f"{file.name}, key cost_w: {data.get('cost_w')}, found {cost_w:.6g}")
    seed = data.get("seed")
    again = solve(problem, Request(seed if isinstance(seed, int) else 0)).data
    timed = {"wall_s": data.get("wall_s"), "problem_file": data.get("problem_file")}
    return reasons + in_words(file.name, differences(data, {**again, **timed}))


def _proof(
    content: DesignProblem, slot_width_s: float, rate_divisor: int, bits_per_axis: int
) -> tuple[Requirement, ...]:
    """Return what the independent verifier requires of a network of these numbers."""
    task, chase, network = content.task, content.task.chase, content.task.network
    data = DesignData(
        chase.evader_speed_m_s,
        chase.pursuer_speed_m_s,
        chase.stage_delay_s,
        network.mote_spacing_m,
        network.bit_rate_bit_s,
        network.header_bits,
        network.record_bits,
        network.slots_per_frame,
        network.slot_blocks,
        task.margin,
        task.first_distance_m,
        task.capture_radius_m,
        task.deadline_s,
    )
    return certify(data, content.theorem, slot_width_s, rate_divisor, bits_per_axis)


def tables(problem: SystemProblem) -> dict[str, Any]:
    """Return the tables with every default; keys without a value are left out."""
    given: DesignFile = problem.given
    return given.model_dump(mode="json", by_alias=True, exclude_none=True)


def words(problem: SystemProblem) -> tuple[str, ...]:
    """Return the problem in lines of text."""
    content: DesignProblem = problem.content
    chase, network = content.task.chase, content.task.network
    side = 2**network.levels
    return (
        f"{problem.name}: {problem.description}",
        f"  task        {problem.task}, {content.method.words}, by {content.theorem.value}",
        f"  pursuit     evader {chase.evader_speed_m_s:g} m/s, pursuer "
        f"{chase.pursuer_speed_m_s:g} m/s",
        f"  network     {side} x {side} motes, {network.mote_spacing_m:g} m apart, "
        f"{network.bit_rate_bit_s:g} bit/s, {network.slots_per_frame} slots a frame",
    )


def _common(problem: SystemProblem, seed: int) -> dict[str, Any]:
    content: DesignProblem = problem.content
    names = {id(method): name for name, method in METHODS.items()}
    return {
        "problem": problem.name,
        "horizon": None,
        "planner": names[id(content.method)],
        "seed": seed,
        "sense": "min",
        "objective_name": "energy_per_capture_j" if content.method.of_energy else "cost_w",
    }


def _without(content: DesignProblem, error: NoDesignError) -> dict[str, Any]:
    """The keys of ``solve`` where nothing serves the pursuit."""
    nothing = dict.fromkeys(
        ("objective", "bound", "gap", "slot_width_s", "rate_divisor", "bits_per_axis", "cost_w")
    )
    return {
        **nothing,
        "termination": Termination.INFEASIBLE.value,
        "verdict": Verdict.NONE.value,
        "guarantee": None,
        "binding": [],
        "inequality": {**_inequality_json(error.inequality), "bits_per_axis": error.bits_per_axis},
        "cost_curve": _cost_curve(content),
        "message": str(error),
    }


def _design_json(
    content: DesignProblem, design: Design, proof: tuple[Requirement, ...]
) -> dict[str, Any]:
    objective, lasts_s = content.worth(design), _capture_time_s(content, design)
    bound = _bound_w(content)
    gap = None if bound is None else abs(bound - objective) / max(abs(objective), 1e-12)
    verified = all(each.holds for each in proof)
    return {
        "termination": Termination.CONVERGED.value,
        "verdict": (Verdict.VERIFIED if verified else Verdict.VIOLATED).value,
        "objective": objective,
        "bound": bound,
        "gap": gap,
        "slot_width_s": design.slot_width_s,
        "rate_divisor": design.rate_divisor,
        "bits_per_axis": design.bits_per_axis,
        "frame_s": design.slot_width_s * content.task.network.slots_per_frame,
        "cost_w": design.cost_w,
        "capture_time_s": lasts_s,
        "energy_per_capture_j": None if lasts_s is None else design.cost_w * lasts_s,
        "binding": list(design.binding),
        "guarantee": _guarantee_json(content, design.guarantees[content.theorem]),
        "guarantees": {
            theorem.value: _guarantee_json(content, each)
            for theorem, each in design.guarantees.items()
        },
        "certificate": {
            "requirements": [
                {**_inequality_json(each.inequality), "strict": each.strict, "holds": each.holds}
                for each in proof
            ]
        },
        "message": "",
    }


def _bound_w(content: DesignProblem) -> float | None:
    """A lower bound on the power by the convex programme, where there is one."""
    if content.method not in (METHODS["least_power"], METHODS["least_power_rated"]):
        return None
    rated = content.method is METHODS["least_power_rated"]
    try:
        found = relaxed_design(content.task, rated=rated, bits_per_axis=content.task.bits_per_axis)
    except NoPlanError:
        return None
    return found.cost_w


def _capture_time_s(content: DesignProblem, design: Design) -> float | None:
    """The longest time to capture that is promised; None without a first distance."""
    first_m, radius_m = content.task.first_distance_m, content.task.capture_radius_m
    if first_m is None:
        return None
    if radius_m is None:
        return finite(design.capture_time_s)
    return finite(design.guarantees[content.theorem].capture_time_s(first_m, radius_m))


def _guarantee_json(content: DesignProblem, guarantee: Guarantee) -> dict[str, Any]:
    first_m, radius_m = content.task.first_distance_m, content.task.capture_radius_m
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


def _chart_json(content: DesignProblem) -> dict[str, Any]:
    """Return the quantities' values, the least cost by bits, and energy against time."""
    return {
        "sensitivities": sensitivities(content.task, content.solver, content.worth),
        "cost_curve": _cost_curve(content),
        "pareto": [] if content.task.first_distance_m is None else _front(content),
    }


def _cost_curve(content: DesignProblem) -> list[dict[str, Any]]:
    """The best design at every number of bits, or what fails with it."""
    rows: list[dict[str, Any]] = []
    for bits in content.task.bits:
        row: dict[str, Any] = {"bits_per_axis": bits}
        try:
            design = content.solver(replace(content.task, bits_per_axis=bits))
        except NoDesignError as error:
            row |= {"objective": None, "slot_width_s": None, "fails": str(error.inequality)}
        else:
            slot_s = design.slot_width_s
            row |= {"objective": content.worth(design), "slot_width_s": slot_s, "fails": None}
        rows.append(row)
    return rows


def _front(content: DesignProblem) -> list[dict[str, Any]]:
    """Designs of least energy for deadlines from the soonest to that of least energy."""
    task = replace(content.task, deadline_s=None, capture_radius_m=None)
    try:
        slowest_s = least_energy_design(task).capture_time_s
    except NoDesignError:
        return []
    assert task.first_distance_m is not None
    # Nobody is caught sooner than by driving straight there.
    driving_s = task.first_distance_m / task.chase.pursuer_speed_m_s
    deadlines = np.geomspace(driving_s, slowest_s * (1.0 + 1e-9), FRONT_DESIGNS * 4)
    return [
        {
            "capture_time_s": design.capture_time_s,
            "energy_per_capture_j": design.energy_per_capture_j,
            "cost_w": design.cost_w,
            "slot_width_s": design.slot_width_s,
            "bits_per_axis": design.bits_per_axis,
        }
        for design in pareto_front(task, deadlines.tolist())
    ]


def _in_words(
    problem: SystemProblem, data: Mapping[str, Any], proof: tuple[Requirement, ...]
) -> tuple[str, ...]:
    content: DesignProblem = problem.content
    binding = " and ".join(data["binding"])
    lines = [
        f"{problem.name}: {data['verdict']}, {content.method.words}",
        f"  slot width {1e3 * data['slot_width_s']:.4g} ms, rate divisor {data['rate_divisor']}, "
        f"{data['bits_per_axis']} bits an axis: {data['cost_w']:.6g} W",
        f"  binding: {binding or 'nothing, the optimum is inside all limits'}",
    ]
    if data["bound"] is not None:
        lines.append(
            f"  lower bound {data['bound']:.6g} W with compression as a continuous variable, gap "
            f"{100.0 * data['gap']:.2g} %"
        )
    if data["capture_time_s"] is not None:
        lines.append(f"  capture within {data['capture_time_s']:.4g} s by {content.theorem.value}")
    if data["energy_per_capture_j"] is not None and content.method.of_energy:
        lines.append(f"  {data['energy_per_capture_j']:.4g} J a capture")
    lines += [f"  {each}" for each in proof]
    worth = sorted(data["sensitivities"].items(), key=lambda item: -abs(item[1]))
    what = "energy" if content.method.of_energy else "power"
    shown = ", ".join(f"{name} {value:+.2f} %" for name, value in worth)
    lines.append(f"  one per cent more changes the least {what}: {shown}")
    return tuple(lines)


def _draw(content: DesignProblem, data: Mapping[str, Any], folder: Path) -> None:
    from planopt.report import draw_design, save_figure

    save_figure(draw_design(content.task, data), folder / PICTURE)


def _number(value: object) -> float:
    return value if isinstance(value, float) else math.nan


SYSTEM = System(
    model=DesignFile,
    build=build,
    tables=tables,
    words=words,
    files=(PICTURE,),
    check=check,
    solve=solve,
)
