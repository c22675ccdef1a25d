"""Plans of the whole library, recorded so that a change which is to keep them is seen to.

``python tests/golden/golden_plans.py`` lists what differs from the record beside this file;
``--write`` records today's plans in its place. Change the record in a commit of its own, whose
message lists each number and why it changed.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from planopt import NoPlanError, load, simulate, solve
from planopt.studies.bench.cases import library_names

RECORD = Path(__file__).with_name("golden_plans.json")
PROBLEMS = tuple(library_names())
SEEDS = (0, 1, 2)

DRIVEN_STEPS = 6
DRIVEN = (
    "connect_rooftop",
    "crowded_track",
    "harbour_reach",
    "harbour_traffic",
    "munich_islands",
    "open_field",
    "outdoor_map",
    "two_station_courier",
)
"""Problems whose first steps of a closed loop are recorded as well: warm starts, histories,
reservations and fallbacks are not seen in a first plan. Without `indoor_learn`: rounding alone
decides there between paths that are worth the same, and other processors drive another way."""

OBJECTIVE_RATIO = 1e-5
"""Objectives agree to this share: other machines round otherwise, and solvers stop at a
tolerance."""

PATH_M = 0.02
"""Places agree to this distance."""


def solved(name: str, seed: int) -> dict[str, Any]:
    """Return the plans of a library problem as recorded."""
    try:
        solution = solve(load(name), seed=seed)
    except NoPlanError:
        return {"verdict": "none", "robots": []}
    return {
        "verdict": solution.verdict.value,
        "robots": [
            {
                "verdict": plan.verdict.value,
                "rung": plan.rung.value,
                "termination": plan.termination.value,
                "objective": float(f"{plan.objective:.9g}"),
                **_path(plan.positions_m),
            }
            for plan in solution.plans
        ],
    }


def driven(name: str) -> dict[str, Any]:
    """Return the first steps of a closed loop as recorded, seed 0."""
    problem = load(name)
    planner = replace(problem.planner, max_steps=DRIVEN_STEPS)
    run = simulate(replace(problem, planner=planner), seed=0)
    return {
        "verdict": "",
        "robots": [
            {
                "verdict": " ".join(verdict.value for verdict in one.log.verdict),
                "rung": " ".join(rung.value for rung in one.log.rung),
                "termination": one.outcome.value,
                "objective": one.metrics.path_m,
                **_path(one.log.positions_m),
            }
            for one in run.runs
        ],
    }


def differences(golden: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Return in words what differs beyond the tolerances; empty if nothing does."""
    if golden["verdict"] != now["verdict"] or len(golden["robots"]) != len(now["robots"]):
        return [f"verdict {golden['verdict']} is now {now['verdict']}"]
    found: list[str] = []
    for number, (old, new) in enumerate(zip(golden["robots"], now["robots"], strict=True)):
        found += [
            f"robot {number}: {key} {old[key]} is now {new[key]}"
            for key in ("verdict", "rung", "termination")
            if old[key] != new[key]
        ]
        if not np.isclose(old["objective"], new["objective"], rtol=OBJECTIVE_RATIO, atol=1e-9):
            found.append(f"robot {number}: objective {old['objective']} is now {new['objective']}")
        places = [np.column_stack([one["x_m"], one["y_m"]]) for one in (old, new)]
        if places[0].shape != places[1].shape:
            found.append(f"robot {number}: {len(places[0])} places are now {len(places[1])}")
        elif (apart_m := float(np.hypot(*(places[1] - places[0]).T).max())) > PATH_M:
            found.append(f"robot {number}: the path is up to {apart_m:.3g} m away")
    return found


def read_record() -> dict[str, dict[str, Any]]:
    """Return what was recorded, by the names that :func:`all_now` has."""
    return json.loads(RECORD.read_text())


def all_now() -> Iterator[tuple[str, dict[str, Any]]]:
    """Solve and drive everything that is recorded."""
    for name in PROBLEMS:
        for seed in SEEDS:
            yield f"{name} seed {seed}", solved(name, seed)
    for name in DRIVEN:
        yield f"{name} driven", driven(name)


def _path(positions_m: Any) -> dict[str, list[float]]:
    """Return places to the millimetre."""
    x_m, y_m = np.round(positions_m, 3).T.tolist()
    return {"x_m": x_m, "y_m": y_m}


def _main(write: bool) -> int:
    """Record today's plans, or print what differs; 1 if something does."""
    if write:
        lines = [f"{json.dumps(name)}: {json.dumps(now)}" for name, now in all_now()]
        RECORD.write_text("{\n" + ",\n".join(lines) + "\n}\n")
        return 0
    record, changed = read_record(), 0
    for name, now in all_now():
        for words in differences(record[name], now):
            changed += 1
            print(f"{name}: {words}")
    print(f"{changed} differences")
    return int(changed > 0)


if __name__ == "__main__":
    sys.exit(_main("--write" in sys.argv[1:]))
