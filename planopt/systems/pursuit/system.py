"""Simulate, print and draw pursuits."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from planopt.errors import NoPlanError
from planopt.files.tables import write_tables
from planopt.problems.systems import Answer, Request, System, SystemProblem
from planopt.problems.world_tables import obstacle_table
from planopt.systems.pursuit.check import check
from planopt.systems.pursuit.driving import Driven, drive, planners, unguaranteed
from planopt.systems.pursuit.results import (
    RECORDS_FILE,
    faults,
    in_words,
    run_json,
    tables_of,
)
from planopt.systems.pursuit.tables import PursuitFile, PursuitProblem, build

PICTURE, ANIMATION = "run.png", "run.gif"
NOT_CAUGHT, NOT_VERIFIED = 4, 3


def simulate(problem: SystemProblem, request: Request) -> Answer:
    """Drive one pursuit and hold it against the theorems that apply."""
    content: PursuitProblem = problem.content
    planner = planners(content, request)[0]
    missed = unguaranteed(content)
    if missed is not None:
        error = NoPlanError(f"capture is not guaranteed: {missed}")
        nothing = dict.fromkeys(("capture_time_s", "guarantee"))
        data: dict[str, Any] = {
            **{"problem": problem.name, "horizon": planner.horizon, "planner": planner.name},
            **{"seed": request.seed, "outcome": "no_plan", "reason": str(error), **nothing},
            **{"metrics": {}, "rungs": {}, "verified_rate": None, "evaders": [], "robots": []},
            **{"wall_s": None, "step_s": None},
        }
        return Answer(None, data, (f"{problem.name}: no plan: {error}",), NOT_CAUGHT, failure=error)
    ends_s = [time.perf_counter()]

    def after_step() -> None:
        ends_s.append(time.perf_counter())
        request.on_step()

    driven = drive(content, planner, request.seed, after_step)
    broken = faults(driven)
    data = {"problem": problem.name, **run_json(driven), "faults": broken}
    data["wall_s"] = ends_s[-1] - ends_s[0]
    data["step_s"] = _step_s(ends_s)
    code = NOT_CAUGHT if driven.pursuit.outcome != "captured" else NOT_VERIFIED if broken else 0
    return Answer(
        driven,
        data,
        (*in_words(problem.name, data), *(f"  {each}" for each in broken)),
        code,
        save=lambda folder: write_tables(folder, tables_of(driven)),
        draw=(lambda folder: _draw(problem.name, driven, folder))
        if content.given.report.figures
        else None,
        step_s=tuple(np.diff(ends_s).tolist()),
    )


def settings(problem: SystemProblem, request: Request) -> list[tuple[int, str]]:
    """Return horizon and planner of each setting that is asked for."""
    return [(each.horizon, each.name) for each in planners(problem.content, request)]


def _step_s(ends_s: list[float]) -> dict[str, float] | None:
    """Wall times of steps; None if there was none."""
    if len(ends_s) < 2:
        return None
    lasts_s = np.diff(np.array(ends_s))
    p50, p95 = np.percentile(lasts_s, [50, 95]).tolist()
    return {"p50": p50, "p95": p95, "max": float(lasts_s.max())}


def tables(problem: SystemProblem) -> dict[str, Any]:
    """Return the tables with every default, obstacles as polygons."""
    content: PursuitProblem = problem.content
    found = content.given.model_dump(mode="json", by_alias=True, exclude_none=True)
    if content.given.world is not None:
        found["world"]["obstacles"] = [obstacle_table(each) for each in content.obstacles]
    return found


def words(problem: SystemProblem) -> tuple[str, ...]:
    """Return the problem in lines of text."""
    content: PursuitProblem = problem.content
    given, service = content.given, content.service
    side = service.motes_per_side
    lines = [
        f"{problem.name}: {problem.description}",
        f"  task        pursuit, planner {given.planner.name}, steps of {given.pursuit.step_s:g} "
        f"s, at most {given.pursuit.max_steps}",
        f"  motes       {side} x {side}, {service.mote_spacing_m:g} m apart, frames of "
        f"{service.frame_s:g} s, {service.bits_per_axis} bits an axis",
        f"  captured    within {given.pursuit.capture_radius_m:g} m",
        f"  world       {len(content.obstacles)} obstacles",
    ]
    lines += [
        f"  pursuer     {each.name} from ({each.start_m[0]:g}, {each.start_m[1]:g}) m, at most "
        f"{each.speed_max_m_s:g} m/s"
        for each in given.pursuers
    ]
    lines += [
        f"  evader      {each.name} from ({each.start_m[0]:g}, {each.start_m[1]:g}) m, "
        f"{each.behaviour.kind}, at most {each.speed_max_m_s:g} m/s"
        for each in given.evaders
    ]
    return tuple(lines)


def _draw(name: str, driven: Driven, folder: Path) -> None:
    from planopt.report import animate_pursuit, draw_pursuit, save_figure

    save_figure(draw_pursuit(name, driven.pursuit), folder / PICTURE)
    animate_pursuit(name, driven.pursuit, folder / ANIMATION)


SYSTEM = System(
    model=PursuitFile,
    build=build,
    tables=tables,
    words=words,
    files=(RECORDS_FILE, PICTURE, ANIMATION),
    check=check,
    simulate=simulate,
    settings=settings,
)
