"""Report a simulated pursuit as JSON, tables and words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.files.tables import Column, Data, table_of_rows
from planopt.planning.files.record import finite
from planopt.pursuit.guarantees import Guarantee
from planopt.pursuit.theorems import Inequality, Theorem
from planopt.systems.pursuit.driving import Driven

STEPS_FILE, RECORDS_FILE = "steps.csv", "records.csv"

STEP_COLUMNS = (
    Column("robot", "name of the pursuer or evader", kind="text", required=True),
    Column("step", "number of the step; 0 is the start", kind="count", required=True),
    Column("t_s", "time", "s", required=True),
    Column("x_m", "position", "m", required=True),
    Column("y_m", "position", "m", required=True),
    Column("heading_rad", "heading of a pursuer that must turn", "rad"),
    Column("chases", "evader that a pursuer chases in the step that begins here", kind="text"),
    Column("aim_x_m", "aim of a pursuer in that step", "m"),
    Column("aim_y_m", "aim of a pursuer in that step", "m"),
)
RECORD_COLUMNS = (
    Column("pursuer", "pursuer that received the report", kind="text", required=True),
    Column("evader", "evader that the report is about", kind="text", required=True),
    Column("t_s", "time of the report", "s", required=True),
    Column("sampled_s", "time when the evader was sensed", "s", required=True),
    Column("reported_x_m", "reported position", "m", required=True),
    Column("reported_y_m", "reported position", "m", required=True),
    Column("error_m", "bound on the error of the reported position", "m", required=True),
)

THEOREMS = (Theorem.ANY_INSTANT, Theorem.SNAPSHOTS)
"""Those whose premises the snapshot service keeps."""

RATIO_ROUNDING = 1e-9
"""Share by which a stage may exceed its bound through rounding."""


@dataclass(frozen=True, eq=False)
class Stages:
    """The stages of one pursuer after one evader against a theorem."""

    pursuer: int  # Their numbers
    evader: int
    guarantee: Guarantee  # What the theorem says
    bounds_m: NDArray[np.float64]  # (k,) W at the start of each stage

    @property
    def largest_share(self) -> float:
        """Largest W of a stage over what the one before allows; 0 for a single stage."""
        if len(self.bounds_m) < 2:
            return 0.0
        return float((self.bounds_m[1:] / self.guarantee.next_bound_m(self.bounds_m[:-1])).max())

    @property
    def kept(self) -> bool:
        """Return whether every stage is within its bound."""
        return self.largest_share <= 1.0 + RATIO_ROUNDING


def stages(driven: Driven) -> Iterator[Stages]:
    """Yield every chase with every theorem that holds and applies."""
    if not driven.in_stages:
        return
    for pursuer in range(len(driven.pursuit.scene.pursuers)):
        for evader in range(len(driven.pursuit.scene.evaders)):
            found = driven.problem.guarantees(pursuer, evader)
            for theorem in THEOREMS:
                if found[theorem].holds:
                    distances = found[theorem].distances
                    bounds_m = driven.pursuit.bounds_m(pursuer, evader, distances)
                    if len(bounds_m):
                        yield Stages(pursuer, evader, found[theorem], bounds_m)


def run_json(driven: Driven) -> dict[str, Any]:
    """Return the JSON object of ``simulate``, wall times left out."""
    pursuit, given = driven.pursuit, driven.problem.given
    names = [each.name for each in given.pursuers]
    times_s = pursuit.times_s.tolist()
    return {
        "horizon": driven.horizon,
        "planner": driven.planner,
        "seed": driven.seed,
        "outcome": pursuit.outcome,
        "reason": _reason(driven),
        "capture_time_s": finite(pursuit.capture_time_s),
        "metrics": _metrics(driven),
        "rungs": {driven.planner: len(times_s) - 1},
        "verified_rate": _verified_rate(driven),
        "guarantee": guarantee_json(driven),
        "evaders": [
            {
                "name": table.name,
                "captured": bool(np.isfinite(caught_s)),
                "capture_time_s": finite(caught_s),
                "captor": None if captor < 0 else names[captor],
            }
            for table, caught_s, captor in zip(
                given.evaders, pursuit.capture_s.tolist(), pursuit.captors.tolist(), strict=True
            )
        ],
        "robots": [
            {
                "name": name,
                "role": role,
                "t_s": times_s,
                "x_m": places[:, 0].tolist(),
                "y_m": places[:, 1].tolist(),
            }
            for name, role, places in _paths(driven)
        ],
    }


def guarantee_json(driven: Driven) -> dict[str, Any]:
    """Return what was promised for the first pursuer and evader, and what came of it.

    A time is promised only where there are no others, whom it may have been after before.
    """
    problem, pursuit = driven.problem, driven.pursuit
    radius_m = problem.given.pursuit.capture_radius_m
    first = pursuit.uses[0] if driven.alone and pursuit.uses else None
    theorems: dict[str, Any] = {}
    for theorem, each in problem.guarantees(0, 0).items():
        if theorem not in THEOREMS:
            continue
        shares = [
            chase.largest_share
            for chase in stages(driven)
            if chase.guarantee.theorem is theorem and len(chase.bounds_m) > 1
        ]
        lasts_s = math.inf
        if first is not None and each.holds:
            first_m = pursuit.away_m(first, each.distances)
            lasts_s = each.capture_time_s(first_m, radius_m)
        theorems[theorem.value] = {
            "distances": each.distances.value,
            "holds": bool(each.holds),
            "inequalities": [_inequality(one) for one in each.inequalities],
            "capture": _inequality(each.captures(radius_m)),
            "ratio": finite(each.ratio),
            "floor_m": finite(each.floor_m),
            "capture_time_s": finite(lasts_s),
            "largest_share_of_bound": max(shares, default=None),
        }
    return {
        "applies": driven.in_stages,
        "detour": problem.arena.detour,
        "theorems": theorems,
    }


def faults(driven: Driven) -> list[str]:
    """Return every bound that a theorem which holds gives and the pursuit did not keep."""
    found: list[str] = []
    pursuit, radius_m = driven.pursuit, driven.problem.given.pursuit.capture_radius_m
    for each in stages(driven):
        name = each.guarantee.theorem.value
        if not each.kept:
            found.append(
                f"{name}: a stage of pursuer {each.pursuer} after evader {each.evader} exceeds "
                f"its bound by {100.0 * (each.largest_share - 1.0):.3g} %"
            )
    if driven.in_stages and driven.alone and pursuit.uses:
        for theorem in THEOREMS:
            promised = driven.problem.guarantees(0, 0)[theorem]
            first_m = pursuit.away_m(pursuit.uses[0], promised.distances)
            lasts_s = promised.capture_time_s(first_m, radius_m)
            # Before the first record nobody drives.
            spent_s = min(pursuit.capture_time_s, float(pursuit.times_s[-1]))
            if spent_s - pursuit.uses[0].time_s > lasts_s * (1.0 + RATIO_ROUNDING):
                found.append(f"{theorem.value}: no capture within {lasts_s:.6g} s")
    return found


def tables_of(driven: Driven) -> dict[str, tuple[Sequence[Column], Data]]:
    """Return columns and data of ``steps.csv`` and ``records.csv``."""
    return {
        STEPS_FILE: (STEP_COLUMNS, table_of_rows(STEP_COLUMNS, _step_rows(driven))),
        RECORDS_FILE: (RECORD_COLUMNS, table_of_rows(RECORD_COLUMNS, _record_rows(driven))),
    }


def in_words(name: str, data: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a run in lines of text."""
    metrics = data["metrics"]
    lines = [
        f"{name}: {data['outcome']} ({data['reason']}), planner {data['planner']}, "
        f"seed {data['seed']}",
        f"  {metrics['steps']} steps, pursuers drove {metrics['pursuer_path_m']:.1f} m, evaders "
        f"{metrics['evader_path_m']:.1f} m",
    ]
    if metrics["records"]:
        lines.append(
            f"  {metrics['records']} records used, on average {metrics['mean_age_s']:.2f} s old "
            f"and {metrics['mean_error_m']:.2f} m off"
        )
    guarantee = data["guarantee"]
    if guarantee["detour"] > 1.0:
        lines.append(
            f"  paths are at most {guarantee['detour']:.4g} times as long as straight lines"
        )
    for theorem, each in guarantee["theorems"].items():
        if not guarantee["applies"]:
            lines.append(f"  {theorem}: speaks of driving in stages (planner drive) alone")
            continue
        failing = [one for one in (*each["inequalities"], each["capture"]) if not one["holds"]]
        if failing:
            lines.append(f"  {theorem}: no guarantee, {failing[0]['text']}")
        else:
            lasts_s, share = each["capture_time_s"], each["largest_share_of_bound"]
            promised = "" if lasts_s is None else f" within {lasts_s:.4g} s"
            reached = (
                "no stage but the first"
                if share is None
                else f"stages reached at most {100.0 * share:.1f} % of their bound"
            )
            lines.append(f"  {theorem}: capture guaranteed{promised}; {reached}")
    return tuple(lines)


def _inequality(inequality: Inequality) -> dict[str, Any]:
    return {
        "text": str(inequality),
        "left": finite(inequality.left),
        "right": finite(inequality.right),
        "unit": inequality.unit,
        "holds": bool(inequality.holds),
    }


def _reason(driven: Driven) -> str:
    pursuit = driven.pursuit
    if pursuit.outcome == "captured":
        return f"after {pursuit.capture_time_s:.2f} s"
    free = int(np.isinf(pursuit.capture_s).sum())
    places = pursuit.evaders_m[np.isinf(pursuit.capture_s)]
    nearest_m = min(
        float(np.linalg.norm(states[:, :2] - each, axis=1).min())
        for states in pursuit.pursuers
        for each in places
    )
    steps = len(pursuit.times_s) - 1
    knew = "" if pursuit.uses else ", and no record ever came"
    return f"{free} not caught in {steps} steps, nearest {nearest_m:.3g} m{knew}"


def _verified_rate(driven: Driven) -> float | None:
    """Share of the chases, by each theorem that applies, whose stages are all within bounds."""
    kept = [each.kept for each in stages(driven)]
    return float(np.mean(kept)) if kept else None


def _metrics(driven: Driven) -> dict[str, Any]:
    pursuit = driven.pursuit
    errors = [float(np.linalg.norm(use.record.reported_m - use.sampled_m)) for use in pursuit.uses]
    return {
        "capture_time_s": finite(pursuit.capture_time_s),
        "steps": len(pursuit.times_s) - 1,
        "pursuer_path_m": sum(_length_m(states[:, :2]) for states in pursuit.pursuers),
        "evader_path_m": sum(_length_m(places) for places in pursuit.evaders_m),
        "records": len(pursuit.uses),
        "mean_age_s": float(np.mean([use.age_s for use in pursuit.uses])) if errors else None,
        "mean_error_m": float(np.mean(errors)) if errors else None,
    }


def _length_m(places: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def _paths(driven: Driven) -> Iterator[tuple[str, str, NDArray[np.float64]]]:
    """Name, role and path or states of everybody."""
    given = driven.problem.given
    for table, states in zip(given.pursuers, driven.pursuit.pursuers, strict=True):
        yield table.name, "pursuer", states
    for table, places in zip(given.evaders, driven.pursuit.evaders_m, strict=True):
        yield table.name, "evader", places


def _step_rows(driven: Driven) -> Iterator[tuple[object, ...]]:
    pursuit = driven.pursuit
    steps = len(pursuit.times_s) - 1
    names = [each.name for each in driven.problem.given.evaders]
    for number, (name, role, states) in enumerate(_paths(driven)):
        for step, (time_s, state) in enumerate(
            zip(pursuit.times_s.tolist(), states.tolist(), strict=True)
        ):
            heading = state[2] if len(state) > 2 else ""
            chases: tuple[object, ...] = ("", "", "")
            if role == "pursuer" and step < steps:
                after = int(pursuit.chased[number, step])
                aim = pursuit.aims_m[number, step].tolist()
                chases = (names[after] if after >= 0 else "", *aim)
            yield (name, step, time_s, state[0], state[1], heading, *chases)


def _record_rows(driven: Driven) -> Iterator[tuple[object, ...]]:
    given = driven.problem.given
    for use in driven.pursuit.uses:
        x_m, y_m = use.record.reported_m.tolist()
        yield (
            given.pursuers[use.pursuer].name,
            given.evaders[use.evader].name,
            use.time_s,
            use.record.sampled_s,
            x_m,
            y_m,
            use.record.error_m,
        )
