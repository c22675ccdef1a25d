"""Judge a saved pursuit from its files: every move, every record, every capture, every number.

Moves are judged by the speeds, the distances and the aims in ``steps.csv``; records by asking again
what the motes could have told; captures by the distances along the steps. Then everything that
the JSON file says is computed again from these tables.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.compare import differences, in_words
from planopt.files.tables import Data, comparable, read_table
from planopt.files.typed_json import whole_number
from planopt.problems.systems import SystemProblem
from planopt.pursuit.knowledge import Track
from planopt.pursuit.records import Record
from planopt.pursuit.simulation import Pursuit, Use
from planopt.systems.pursuit.driving import Driven
from planopt.systems.pursuit.results import (
    RECORD_COLUMNS,
    RECORDS_FILE,
    STEP_COLUMNS,
    STEPS_FILE,
    faults,
    run_json,
    tables_of,
)
from planopt.systems.pursuit.tables import PursuitProblem

PLACE_M = 1e-6
"""Places that are computed again agree to this."""

TIME_S = 1e-6
"""Times that are computed again agree to this."""

SHARES = 33
"""Instants of a step at which distances are looked at."""

GRAZE_SHARE = 1e-3
"""Share of the capture radius by which an earlier capture may be missed between instants."""


def check(file: Path, data: Mapping[str, Any], problem: SystemProblem) -> list[str]:
    """Return what is wrong with a saved pursuit; nothing if it holds."""
    if data.get("outcome") == "no_plan":
        return [f"there is no run to judge: {data.get('reason')}"]
    content: PursuitProblem = problem.content
    pursuit, tables = _read(file, data, content)
    driven = Driven(
        content,
        pursuit,
        str(data.get("planner")),
        whole_number(file, data, "horizon"),
        whole_number(file, data, "seed"),
    )
    reasons = [
        *_moves(driven),
        *_records(driven),
        *_captures(driven),
        *faults(driven),
    ]
    kept = {key: data.get(key) for key in ("wall_s", "step_s", "problem_file")}
    found = {"problem": problem.name, **run_json(driven), "faults": faults(driven), **kept}
    for name, (_, table) in tables_of(driven).items():
        reasons += in_words(name, differences(comparable(tables[name]), comparable(table)))
    return reasons + in_words(file.name, differences(data, found))


def _moves(driven: Driven) -> list[str]:
    """Nobody is too fast, out of bounds or too near an obstacle, and pursuers drive to aims."""
    pursuit, problem = driven.pursuit, driven.problem
    step_s, reasons = problem.given.pursuit.step_s, list[str]()
    for number, table in enumerate(problem.given.pursuers):
        states, motion = pursuit.pursuers[number], table.motion
        if len(states) > 1:
            again = motion.towards(states[:-1], pursuit.aims_m[number], step_s)
            off_m = np.abs(again - states[1:]).max(axis=1)
            if off_m.max() > PLACE_M:
                reasons.append(_at(table.name, off_m, "does not drive to its aim, off by", "m"))
        reasons += _path_faults(driven, table.name, states[:, :2], table.speed_max_m_s)
    for number, table in enumerate(problem.given.evaders):
        reasons += _path_faults(driven, table.name, pursuit.evaders_m[number], table.speed_max_m_s)
    return reasons


def _path_faults(
    driven: Driven, name: str, places: NDArray[np.float64], speed_m_s: float
) -> list[str]:
    problem, reasons = driven.problem, list[str]()
    if not np.isfinite(places).all():
        return [f"{STEPS_FILE}: {name} is at no finite place"]
    step_s = problem.given.pursuit.step_s
    over_m = np.linalg.norm(np.diff(places, axis=0), axis=1) - speed_m_s * step_s
    if len(over_m) and over_m.max() > PLACE_M:
        reasons.append(_at(name, over_m, "is too fast, in a step by", "m"))
    bounds = problem.arena.bounds_m
    if bounds is not None:
        low, high = np.array(bounds[:2]) - PLACE_M, np.array(bounds[2:]) + PLACE_M
        if ((places < low) | (places > high)).any():
            reasons.append(f"{STEPS_FILE}: {name} leaves world.bounds_m")
    if problem.obstacles:
        path = shapely.LineString(places) if len(places) > 1 else shapely.Point(places[0])
        nearest_m = min(float(path.distance(each.polygon)) for each in problem.obstacles)
        if nearest_m < 0.999 * problem.arena.clearance_m - PLACE_M:
            reasons.append(
                f"{STEPS_FILE}: {name} comes within {nearest_m:.4g} m of an obstacle, "
                f"pursuit.clearance_m is {problem.arena.clearance_m:g}"
            )
    return reasons


def _records(driven: Driven) -> list[str]:
    """Every record is one that a mote there and then could have told, and none is older."""
    reasons, service, last = list[str](), driven.problem.service, dict[tuple[int, int], float]()
    pursuit = driven.pursuit
    for row, use in enumerate(pursuit.uses, start=2):
        where = f"{RECORDS_FILE}, row {row}"
        track = Track(pursuit.times_s, pursuit.evaders_m[use.evader])
        ages = service.sample_numbers(use.time_s) * service.periods_s
        mote = service.cells(use.place_m, 0)
        told = False
        for level, sampled_s in enumerate(ages.tolist()):
            place = track.at(np.array(sampled_s))
            near = np.abs((mote >> level) - service.cells(place, level)).max() <= 1
            told |= bool(
                near
                and abs(sampled_s - use.record.sampled_s) <= TIME_S
                and np.abs(service.reported_m(place, level) - use.record.reported_m).max()
                <= PLACE_M
                and abs(service.error_bound_m(level) - use.record.error_m) <= PLACE_M
            )
        if not told:
            reasons.append(f"{where}: no mote could have told this record")
        before = last.get((use.pursuer, use.evader), -math.inf)
        if use.record.sampled_s < before - TIME_S:
            reasons.append(f"{where}: an older record replaces a fresher one")
        last[use.pursuer, use.evader] = use.record.sampled_s
    return reasons


def _captures(driven: Driven) -> list[str]:
    """Check that who is caught is within the radius then, and nobody was before."""
    pursuit, reasons = driven.pursuit, list[str]()
    rules = driven.problem.given.pursuit
    shares = np.linspace(0.0, 1.0, SHARES)
    for evader, table in enumerate(driven.problem.given.evaders):
        caught_s = float(pursuit.capture_s[evader])
        places = pursuit.evaders_m[evader]
        for step in range(len(pursuit.times_s) - 1):
            begun_s = float(pursuit.times_s[step])
            if caught_s <= begun_s:
                break
            here, there = places[step], places[step + 1]
            # In its last step an evader is at the saved place when it is caught.
            lasts = min(1.0, (caught_s - begun_s) / rules.step_s)
            moving = here + np.minimum(shares / lasts, 1.0)[:, None] * (there - here)
            nearest = min(
                float(
                    np.linalg.norm(moving - _driven_m(driven, number, step, shares), axis=1)[
                        shares < lasts
                    ].min()
                )
                for number in range(len(pursuit.pursuers))
            )
            if nearest < rules.capture_radius_m * (1.0 - GRAZE_SHARE):
                reasons.append(
                    f"{STEPS_FILE}: {table.name} is within the capture radius at {begun_s:.4g} s "
                    "without being caught"
                )
                break
        if math.isfinite(caught_s):
            reasons += _capture_faults(driven, evader, caught_s)
    return reasons


def _capture_faults(driven: Driven, evader: int, caught_s: float) -> list[str]:
    pursuit, rules = driven.pursuit, driven.problem.given.pursuit
    step = min(int(caught_s / rules.step_s + 1e-9), len(pursuit.times_s) - 2)
    name = driven.problem.given.evaders[evader].name
    if step < 0 or caught_s > pursuit.times_s[-1] + TIME_S:
        return [f"evaders, {name}: is caught after the end"]
    share = np.array([caught_s / rules.step_s - step])
    captor = int(pursuit.captors[evader])
    place = _driven_m(driven, captor, step, share)[0]
    away_m = float(np.linalg.norm(place - pursuit.evaders_m[evader][step + 1]))
    if away_m > rules.capture_radius_m + GRAZE_SHARE * rules.capture_radius_m:
        return [f"evaders, {name}: is {away_m:.4g} m away from its captor when it is caught"]
    return []


def _driven_m(
    driven: Driven, number: int, step: int, shares: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return where a pursuer is at shares (k,) of a step; ``(k, 2)``."""
    motion = driven.problem.given.pursuers[number].motion
    state, aim_m = driven.pursuit.pursuers[number][step], driven.pursuit.aims_m[number, step]
    step_s = driven.problem.given.pursuit.step_s
    return np.array([motion.towards(state, aim_m, share * step_s)[:2] for share in shares.tolist()])


def _at(name: str, off: NDArray[np.float64], words: str, unit: str) -> str:
    step = int(off.argmax())
    return f"{STEPS_FILE}: {name} {words} {off[step]:.4g} {unit} at step {step}"


def _read(
    file: Path, data: Mapping[str, Any], content: PursuitProblem
) -> tuple[Pursuit, dict[str, Data]]:
    """Return the pursuit in the tables beside the JSON file, and these."""
    given, path = content.given, file.parent / STEPS_FILE
    steps = read_table(path, STEP_COLUMNS)
    names = [each.name for each in (*given.pursuers, *given.evaders)]
    count = len(steps["step"]) // len(names)
    if count < 1 or len(steps["step"]) != count * len(names):
        message = f"has {len(steps['step'])} rows, not as many for each of {len(names)}"
        raise InputError(message, file=path)
    rows = {name: column.reshape(len(names), count) for name, column in steps.items()}
    times_s, pursuers = rows["t_s"][0], len(given.pursuers)
    if np.abs(times_s - np.arange(count) * given.pursuit.step_s).max() > TIME_S:
        raise InputError("are not pursuit.step_s apart", file=path, key="t_s")
    evaders = [each.name for each in given.evaders]
    chases = rows["chases"][:pursuers, :-1]
    if not np.isin(chases, ["", *evaders]).all():
        raise InputError("names no evader", file=path, key="chases")
    aims = np.stack([rows["aim_x_m"], rows["aim_y_m"]], axis=-1)[:pursuers, :-1]
    if not np.isfinite(aims).all():
        raise InputError("has no aim", file=path, key="aim_x_m")
    places = np.stack([rows["x_m"], rows["y_m"]], axis=-1)
    states: list[NDArray[np.float64]] = []
    for number, table in enumerate(given.pursuers):
        turns = table.turn_rate_max_rad_s is not None
        if turns and not np.isfinite(rows["heading_rad"][number]).all():
            raise InputError("has no heading", file=path, key="heading_rad")
        own = [places[number], rows["heading_rad"][number][:, None]] if turns else [places[number]]
        states.append(np.hstack(own))
    said = data.get("evaders")
    capture_s, captors = np.full(len(evaders), np.inf), np.full(len(evaders), -1)
    if not isinstance(said, list) or len(cast("list[object]", said)) != len(evaders):
        raise InputError("has not one entry for each evader", file=file, key="evaders")
    own_names = [each.name for each in given.pursuers]
    for number, entry in enumerate(cast("list[Any]", said)):
        row = cast("dict[str, Any]", entry) if isinstance(entry, dict) else dict[str, Any]()
        time_s, captor = row.get("capture_time_s"), row.get("captor")
        if isinstance(time_s, float | int) and captor in own_names:
            capture_s[number], captors[number] = float(time_s), own_names.index(captor)
    numbers = {name: number for number, name in enumerate(["", *evaders], start=-1)}
    chased = np.vectorize(numbers.__getitem__, otypes=[np.intp])(chases)
    scene = content.scene(given.planner, np.random.default_rng(0))
    records = read_table(file.parent / RECORDS_FILE, RECORD_COLUMNS)
    evaders_m = places[pursuers:]
    uses = _uses(file.parent / RECORDS_FILE, records, content, times_s, states, evaders_m)
    pursuit = Pursuit(
        scene, times_s, tuple(states), evaders_m, chased, aims, capture_s, captors, uses
    )
    return pursuit, {STEPS_FILE: steps, RECORDS_FILE: records}


def _uses(
    path: Path,
    records: Data,
    content: PursuitProblem,
    times_s: NDArray[np.float64],
    states: list[NDArray[np.float64]],
    evaders_m: NDArray[np.float64],
) -> tuple[Use, ...]:
    given = content.given
    pursuers = [each.name for each in given.pursuers]
    evaders = [each.name for each in given.evaders]
    found: list[Use] = []
    columns = (records[column.name].tolist() for column in RECORD_COLUMNS)
    for row, (name, other, time_s, sampled_s, x, y, error_m) in enumerate(
        zip(*columns, strict=True), start=2
    ):
        if name not in pursuers or other not in evaders:
            raise InputError("names nobody of the problem", file=path, row=row)
        pursuer, evader = pursuers.index(name), evaders.index(other)
        step = round(time_s / given.pursuit.step_s)
        if not (0 <= step < len(times_s) and abs(times_s[step] - time_s) <= TIME_S):
            raise InputError("is at no step of the run", file=path, key="t_s", row=row)
        record = Record(sampled_s, np.array([x, y]), error_m)
        sampled_m = Track(times_s, evaders_m[evader]).at(np.array(sampled_s))
        place_m = states[pursuer][step, :2]
        found.append(Use(pursuer, evader, time_s, place_m, record, sampled_m))
    return tuple(found)
