"""Compare planners and horizons of a network over the same seeds."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.problems.systems import Answer, Request, SystemProblem
from planopt.systems.coverage.build import CoverageProblem
from planopt.systems.coverage.check import faults
from planopt.systems.coverage.driving import REACHED, drive, planners
from planopt.systems.coverage.results import metrics, outcome
from planopt.systems.coverage.tables import PlannerTable

METRICS = ("cost_mean", "cost_last", "path_m", "energy_m2_s")
"""What settings are compared by."""

INTERVAL_Z = 1.96
"""Half width of 95 % intervals in standard errors."""

NOT_REACHED, NOT_VERIFIED = 4, 3


def compare(problem: SystemProblem, request: Request) -> Answer:
    """Simulate every setting under every seed; ratios are paired with the first setting.

    Coverage cost is averaged over the same time in all runs of a seed: a run that has settled keeps
    its last cost.
    """
    content: CoverageProblem = problem.content
    settings, began = planners(content, request), time.perf_counter()
    shape = (len(settings), len(request.seeds))
    values = {metric: np.zeros(shape) for metric in METRICS}
    walls_s, missed, broken = np.zeros(shape), np.zeros(shape, dtype=np.bool_), 0
    steps = round(content.given.control.duration_s / content.given.control.time_step_s)
    for row, planner in enumerate(settings):
        for column, seed in enumerate(request.seeds):
            start = time.perf_counter()
            driven = drive(content, planner, seed)
            costs = driven.run.costs
            walls_s[row, column] = (time.perf_counter() - start) / len(costs)
            found = metrics(driven)
            held = float(costs.sum()) + (steps - len(costs)) * float(costs[-1])
            found["cost_mean"] = held / steps
            for metric in METRICS:
                values[metric][row, column] = found[metric]
            missed[row, column] = outcome(driven)[0] not in REACHED
            broken += bool(faults(driven))
            request.on_step()
    rows = [
        {
            **_row(planner, metric, values[metric][row], values[metric][0]),
            "stalled": int(missed[row].sum()),
            "verified_rate": None,
            "p50_step_s": float(np.percentile(walls_s[row], 50)),
            "p95_step_s": float(np.percentile(walls_s[row], 95)),
        }
        for metric in METRICS
        for row, planner in enumerate(settings)
    ]
    data = {
        "problem": problem.name,
        "outcome": "compared",
        "rows": rows,
        "runs": [
            {
                "planner": planner.name,
                "horizon": planner.horizon,
                "seed": seed,
                **{metric: float(values[metric][row, column]) for metric in METRICS},
            }
            for row, planner in enumerate(settings)
            for column, seed in enumerate(request.seeds)
        ],
        "faults": broken,
        "wall_s": time.perf_counter() - began,
        "message": "",
    }
    code = NOT_VERIFIED if broken else NOT_REACHED if missed.any() else 0
    drawn = content.given.report.figures
    return Answer(
        data,
        data,
        _in_words(problem.name, rows),
        code,
        draw=(lambda folder: _draw(data, folder)) if drawn else None,
    )


def _row(
    planner: PlannerTable,
    metric: str,
    values: NDArray[np.float64],
    first: NDArray[np.float64],
) -> dict[str, Any]:
    """One setting and metric: its mean and interval, and the paired ratio to the first setting."""
    mean, low, high = _interval(values)
    both = (values > 0.0) & (first > 0.0)
    ratio = _interval(np.log(values[both] / first[both]))
    paired = [None if value is None else float(np.exp(value)) for value in ratio]
    return {
        "horizon": planner.horizon,
        "planner": planner.name,
        "seeds": len(values),
        "metric": metric,
        "mean": mean,
        "ci_low": low,
        "ci_high": high,
        "paired_ratio": paired[0],
        "paired_low": paired[1],
        "paired_high": paired[2],
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
    lines = [f"{name}: means over {rows[0]['seeds']} seeds; paired ratio to the first setting"]
    for row in rows:
        setting = row["planner"] + ("" if row["planner"] == "law" else f" {row['horizon']}")
        ratio = ""
        if row["paired_ratio"] is not None and row["paired_low"] is not None:
            ratio = (
                f", ratio {row['paired_ratio']:.4f} ({row['paired_low']:.4f} to "
                f"{row['paired_high']:.4f})"
            )
        lines.append(f"  {row['metric']:12} {setting:14} {row['mean']:.6g}{ratio}")
    return tuple(lines)


def _draw(data: dict[str, Any], folder: Path) -> None:
    from planopt.report.coverage_figure import draw_horizons
    from planopt.report.saving import save_figure

    save_figure(draw_horizons(data["problem"], data["rows"]), folder / "comparison.png")
