"""Check a saved pursuit: verify its tables, then compute again what the JSON file says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.compare import differences, in_words
from planopt.files.tables import Data, comparable, read_table
from planopt.files.typed_json import whole_number
from planopt.problems.systems import SystemProblem
from planopt.pursuit.certificate import Claim, verify_guarantees
from planopt.pursuit.records import Record, Track
from planopt.pursuit.simulation import Pursuit, Use
from planopt.pursuit.theorems import Distances, Theorem
from planopt.pursuit.verify import PursuitData, PursuitLog, Reports, Robot, Service, verify_pursuit
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

TIME_S = 1e-6
"""Times that are read agree with steps to this."""


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
        *_verified(driven, data),
        *faults(driven),
    ]
    kept = {key: data.get(key) for key in ("wall_s", "step_s", "problem_file")}
    found = {"problem": problem.name, **run_json(driven), "faults": faults(driven), **kept}
    for name, (_, table) in tables_of(driven).items():
        reasons += in_words(name, differences(comparable(tables[name]), comparable(table)))
    return reasons + in_words(file.name, differences(data, found))


def _verified(driven: Driven, data: Mapping[str, Any]) -> Iterator[str]:
    """Yield what the independent verifier finds in the logged pursuit and in its guarantee."""
    facts, log = facts_of(driven.problem, driven.planner), log_of(driven.pursuit)
    violations = verify_pursuit(facts, log)
    if not violations:
        # What a run claims is compared with what it should claim elsewhere: a key may be missing.
        with suppress(KeyError, TypeError, ValueError, AttributeError):
            said = data["guarantee"]
            claims = tuple(
                Claim(
                    Theorem(name),
                    Distances(each["distances"]),
                    each["holds"],
                    each["capture"]["holds"],
                    each["capture_time_s"],
                )
                for name, each in said["theorems"].items()
            )
            violations += verify_guarantees(facts, log, claims, float(said["detour"]))
    for each in violations:
        yield f"{RECORDS_FILE if each.kind in ('report', 'order') else STEPS_FILE}: {each.text}"


def facts_of(problem: PursuitProblem, planner: str) -> PursuitData:
    """Return what the verifier needs of a problem."""
    given = problem.given
    robots = {"name", "start_m", "start_radius_m", "speed_max_m_s", "turn_rate_max_rad_s"}
    return PursuitData(
        tuple(Robot(**each.model_dump(include=robots)) for each in given.pursuers),
        tuple(Robot(**each.model_dump(include=robots)) for each in given.evaders),
        Service(**given.network.model_dump()),
        given.pursuit.capture_radius_m,
        given.pursuit.step_s,
        given.pursuit.max_steps,
        planner,
        None if given.world is None else given.world.bounds_m,
        tuple(each.polygon for each in problem.obstacles),
        given.pursuit.clearance_m,
    )


def log_of(pursuit: Pursuit) -> PursuitLog:
    """Return what the verifier needs of a pursuit."""
    uses = pursuit.uses
    reports = Reports(
        np.array([use.pursuer for use in uses], dtype=np.intp),
        np.array([use.evader for use in uses], dtype=np.intp),
        np.array([use.time_s for use in uses]),
        np.array([use.record.sampled_s for use in uses]),
        np.array([use.record.reported_m for use in uses]).reshape(-1, 2),
        np.array([use.record.error_m for use in uses]),
    )
    return PursuitLog(
        pursuit.times_s,
        pursuit.pursuers,
        pursuit.aims_m,
        pursuit.chased,
        pursuit.evaders_m,
        pursuit.capture_s,
        pursuit.captors,
        reports,
    )


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
