"""Compare planners and horizons of a pursuit over the same seeds."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.planning.files.solution_json import finite
from planopt.problems.systems import Answer, Request, SystemProblem
from planopt.systems.pursuit.driving import drive, planners
from planopt.systems.pursuit.results import faults
from planopt.systems.pursuit.tables import PlannerTable, PursuitProblem

INTERVAL_Z = 1.96
"""Half width of 95 % intervals in standard errors."""

NOT_CAUGHT, NOT_VERIFIED = 4, 3


def compare(problem: SystemProblem, request: Request) -> Answer:
    """Drive every setting under every seed; ratios are paired with the first setting."""
    content: PursuitProblem = problem.content
    settings, began = planners(content, request), time.perf_counter()
    times_s = np.full((len(settings), len(request.seeds)), np.inf)
    walls_s = np.zeros_like(times_s)
    broken = 0
    for row, planner in enumerate(settings):
        for column, seed in enumerate(request.seeds):
            start = time.perf_counter()
            driven = drive(content, planner, seed, lambda: None)
            steps = max(1, len(driven.pursuit.times_s) - 1)
            walls_s[row, column] = (time.perf_counter() - start) / steps
            times_s[row, column] = driven.pursuit.capture_time_s
            broken += bool(faults(driven))
            request.on_step()
    rows = [
        _row(planner, times_s[row], times_s[0], walls_s[row])
        for row, planner in enumerate(settings)
    ]
    stalled = sum(row["stalled"] for row in rows)
    data = {
        "problem": problem.name,
        "outcome": "compared",
        "rows": rows,
        "runs": [
            {
                "planner": planner.name,
                "horizon": planner.horizon,
                "seed": seed,
                "capture_time_s": finite(times_s[row, column]),
            }
            for row, planner in enumerate(settings)
            for column, seed in enumerate(request.seeds)
        ],
        "faults": broken,
        "wall_s": time.perf_counter() - began,
        "message": "",
    }
    code = NOT_CAUGHT if stalled else NOT_VERIFIED if broken else 0
    return Answer(data, data, _in_words(problem.name, rows), code, draw=_drawn(content, data))


def _row(
    planner: PlannerTable,
    times_s: NDArray[np.float64],
    first_s: NDArray[np.float64],
    walls_s: NDArray[np.float64],
) -> dict[str, Any]:
    """One setting: mean time to capture with its interval, and the paired ratio to the first.

    The ratio is that of geometric means over seeds that both settings capture in.
    """
    caught = times_s[np.isfinite(times_s)]
    mean, low, high = _interval(caught)
    both = np.isfinite(times_s) & np.isfinite(first_s) & (times_s > 0.0) & (first_s > 0.0)
    ratio = _interval(np.log(times_s[both] / first_s[both]))
    paired = [None if value is None else float(np.exp(value)) for value in ratio]
    return {
        "horizon": planner.horizon,
        "planner": planner.name,
        "seeds": len(times_s),
        "stalled": int(np.isinf(times_s).sum()),
        "metric": "capture_time_s",
        "mean": mean,
        "ci_low": low,
        "ci_high": high,
        "paired_ratio": paired[0],
        "paired_low": paired[1],
        "paired_high": paired[2],
        "verified_rate": None,
        "p50_step_s": float(np.percentile(walls_s, 50)),
        "p95_step_s": float(np.percentile(walls_s, 95)),
    }


def _interval(values: NDArray[np.float64]) -> tuple[float | None, float | None, float | None]:
    """Mean and the ends of its 95 % interval; None of nothing."""
    if len(values) == 0:
        return None, None, None
    mean = float(values.mean())
    if len(values) == 1:
        return mean, None, None
    half = INTERVAL_Z * float(values.std(ddof=1)) / len(values) ** 0.5
    return mean, mean - half, mean + half


def _in_words(name: str, rows: list[dict[str, Any]]) -> tuple[str, ...]:
    lines = [f"{name}: time to capture [s], 95 % intervals; ratio to the first setting"]
    for row in rows:
        setting = row["planner"] + (f" {row['horizon']}" if row["planner"] == "receding" else "")
        mean = "-" if row["mean"] is None else f"{row['mean']:.2f}"
        ends = "" if row["ci_low"] is None else f" ({row['ci_low']:.2f} to {row['ci_high']:.2f})"
        ratio = ""
        if row["paired_ratio"] is not None and row["paired_low"] is not None:
            ratio = (
                f", ratio {row['paired_ratio']:.3f} ({row['paired_low']:.3f} to "
                f"{row['paired_high']:.3f})"
            )
        lines.append(
            f"  {setting:12} {mean}{ends}{ratio}, {row['stalled']} of {row['seeds']} not caught"
        )
    return tuple(lines)


def _drawn(content: PursuitProblem, data: dict[str, Any]) -> Any:
    if not content.given.report.figures:
        return None

    def draw(folder: Path) -> None:
        from planopt.report.pursuit_figure import draw_capture_times
        from planopt.report.saving import save_figure

        save_figure(draw_capture_times(data["problem"], data["rows"]), folder / "comparison.png")

    return draw
