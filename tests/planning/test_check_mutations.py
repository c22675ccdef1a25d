"""Every field of a saved plan and run is edited, one at a time: check must reject it and say which.

No field is listed here but those that may be edited unnoticed, each with its reason.
"""

import csv
import io
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planopt import load
from planopt.errors import InputError
from planopt.planning.check import check_belief
from planopt.planning.check.check import CheckResult, check
from planopt.planning.files.saved import save_run, save_solution
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.loop.learn import learn
from planopt.planning.loop.log import Outcome
from planopt.planning.plan import Rung, Termination, Verdict
from planopt.planning.solve import solve

WALL_TIME = "a wall time: only its order and its sign can be judged"
SOLVER = "only the solver knows it: it must fit rung and termination, which the edit does"
UNPROVEN = {
    "wall_s": WALL_TIME,
    "solve_s": WALL_TIME,
    "step_s.max": WALL_TIME,
    "iterations": SOLVER,
    "certificate.kkt_residual": SOLVER,
    "robots[].wall_s": WALL_TIME,
    "robots[].solve_s": WALL_TIME,
    "robots[].iterations": SOLVER,
    "robots[].certificate.kkt_residual": SOLVER,
    "plans[].released[].kkt_residual": SOLVER,
}

NAMED_BY = {
    "lattice_objective": "polish_gain",
    "pivot": "objective",
    "seed": "with seed",
    "plans": "the plan for step",
}
"""What contradicts a field that cannot be computed itself: the reason names that."""

OTHER_LABELS = {
    "verdict": Verdict.VIOLATED.value,
    "rung": Rung.STOP.value,
    "termination": Termination.NO_PATH.value,
    "outcome": Outcome.STALLED.value,
    "cost_to_go": "geodesic",
    "planner": "lattice",
    "planner.name": "lattice",
    "method": "capped",
}
"""What else could stand there."""

LATER = ("crossings",)
"""A key that plans saved before it was there may lack."""

MALFORMED = ("problem.schema", "problem.task")
"""Keys of a problem that no other value is valid for: an error, as for any damaged file."""


@pytest.fixture(scope="module", autouse=True)
def _learnt_once() -> Iterator[None]:
    """Fit the same measurements once, not for each of some hundred checks."""
    kept: dict[tuple[object, ...], Any] = {}

    def learn_once(problem, measurements, station):
        columns = (np.ascontiguousarray(c).tobytes() for c in vars(measurements).values())
        key = (problem.channel, problem.stations, station, *columns)
        if key not in kept:
            kept[key] = learn(problem, measurements, station)
        return kept[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(check_belief, "learn", learn_once)
        yield


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A plan, a plan that misses the bound at two steps with proof, and a run that measures."""
    problem = load("open_field")
    made = {name: tmp_path_factory.mktemp(name) for name in ("plan", "relaxed", "run")}
    save_solution(solve(problem, horizon=3), made["plan"])
    deaf = replace(problem, stations=(replace(problem.stations[0], threshold_dbm=-48.0),))
    save_solution(solve(deaf, horizon=5, seed=1), made["relaxed"])
    short = replace(problem, planner=replace(problem.planner, max_steps=4))
    save_run(simulate(short, horizon=3, seed=1), made["run"])
    return made


@pytest.fixture(params=["plan", "relaxed", "run"])
def folder(request: pytest.FixtureRequest, folders: dict[str, Path]) -> Iterator[Path]:
    """Each of them, put back as it was after the test."""
    chosen = folders[request.param]
    files = {file: file.read_bytes() for file in chosen.iterdir()}
    assert check(chosen).verdict is Verdict.VERIFIED
    yield chosen
    for file, content in files.items():
        file.write_bytes(content)


def json_file(folder: Path) -> Path:
    """The JSON file of a folder."""
    return next(folder.glob("*.json"))


def leaves(value: Any, key: str = "") -> Iterator[tuple[str, list[Any]]]:
    """Key and way of every value that is no table; of an array's values the middle one."""
    if isinstance(value, dict):
        for name, part in value.items():
            for where, way in leaves(part, f"{key}.{name}".removeprefix(".")):
                yield where, [name, *way]
    elif isinstance(value, list) and value:
        if isinstance(value[0], (dict, list)):
            places = range(len(value))
        else:
            places = range(len(value) // 2, len(value) // 2 + 1)
        for place in places:
            for where, way in leaves(value[place], f"{key}[{place}]"):
                yield where, [place, *way]
    else:
        yield key, []


def pattern(key: str) -> str:
    """`key` without the numbers of array elements."""
    return re.sub(r"\[\d+\]", "[]", key)


def edited(value: Any, key: str) -> Any:
    """Something else of the same kind, that could stand there."""
    name = pattern(key).rpartition(".")[2]
    label = OTHER_LABELS.get(".".join(key.split(".")[-2:]), OTHER_LABELS.get(name))
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if key.startswith("step_s."):
        return value + 1e3  # out of order, however slow the machine was
    if isinstance(value, float):
        return value + 0.0625 * max(1.0, abs(value))
    if isinstance(value, str):
        return label if label is not None else value + "x"
    return [1] if value == [] else 0.5


def set_at(data: Any, way: list[Any], value: Any) -> None:
    """Put `value` where `way` leads."""
    for part in way[:-1]:
        data = data[part]
    data[way[-1]] = value


def get_at(data: Any, way: list[Any]) -> Any:
    """What stands where `way` leads."""
    for part in way:
        data = data[part]
    return data


def names_it(texts: tuple[str, ...], key: str) -> bool:
    """Whether one of the texts names the field, or what stands for it."""
    parts = pattern(key).replace("[]", "").split(".")
    words = {parts[-1], *(word for part, word in NAMED_BY.items() if part in parts)}
    return any(re.search(rf"\b{re.escape(word)}\b", text) for text in texts for word in words)


def judged(folder: Path) -> CheckResult:
    """What check says; its error counts as a rejection by that reason."""
    try:
        return check(folder)
    except InputError as error:
        return CheckResult(Verdict.VIOLATED, (), (str(error),))


def test_every_key_is_judged(folder: Path) -> None:
    """Whatever key is edited, check rejects it and names it, but for those it cannot judge."""
    file = json_file(folder)
    data = json.loads(file.read_text())
    missed: list[str] = []
    seen: set[str] = set()
    for key, way in leaves(data):
        if key.startswith("problem_file") or pattern(key) in UNPROVEN:
            continue
        seen.add(pattern(key))
        changed = json.loads(json.dumps(data))
        set_at(changed, way, edited(get_at(data, way), key))
        file.write_text(json.dumps(changed))
        result = judged(folder)
        if result.verdict is not Verdict.VIOLATED or not names_it(result.reasons, key):
            missed.append(f"{key}: {result.verdict}, {result.reasons[:3]}")
    assert missed == []
    assert {"seed", "horizon", "planner"} < seen and len(seen) >= 20


def test_every_key_of_the_problem_is_judged(folder: Path) -> None:
    """Another problem than the library's is rejected by what it contradicts, or remarked upon."""
    file = json_file(folder)
    data = json.loads(file.read_text())
    missed: list[str] = []
    for key, way in leaves(data["problem_file"]):
        changed = json.loads(json.dumps(data))
        set_at(changed["problem_file"], way, edited(get_at(data["problem_file"], way), key))
        file.write_text(json.dumps(changed))
        if key in MALFORMED:
            with pytest.raises(InputError, match=key.replace(".", r"\.")):
                check(folder)
            continue
        result = judged(folder)
        texts = (*result.reasons, *result.remarks)
        if not names_it(texts, key):
            missed.append(f"{key}: {result.verdict}, {texts[:3]}")
    assert missed == []


def test_a_key_that_is_gone_or_new_is_seen(folder: Path) -> None:
    """No key may be missing, and none may be there that is not judged."""
    file = json_file(folder)
    data = json.loads(file.read_text())
    del data["problem_file"]["report"]
    ways = {tuple(way[:stop]) for _, way in leaves(data) for stop in range(1, len(way) + 1)}
    missed: list[str] = []
    for way in sorted(ways, key=str):
        if way[0] == "problem_file" or not isinstance(way[-1], str) or way == LATER:
            continue
        changed = json.loads(json.dumps(data))
        del get_at(changed, list(way[:-1]))[way[-1]]
        file.write_text(json.dumps(changed))
        result = judged(folder)
        if result.verdict is not Verdict.VIOLATED or way[-1] not in str(result.reasons):
            missed.append(f"without {way}")
    for way in {way[:-1] for way in ways if isinstance(way[-1], str)}:
        changed = json.loads(json.dumps(data))
        get_at(changed, list(way))["optimal"] = True
        file.write_text(json.dumps(changed))
        result = judged(folder)
        if result.verdict is not Verdict.VIOLATED or "optimal" not in str(result.reasons):
            missed.append(f"new in {way}")
    assert missed == []


def test_every_column_is_judged(folder: Path) -> None:
    """Whatever cell of the last row is edited, check rejects it and names row and column."""
    file = folder / "steps.csv"
    rows = list(csv.reader(io.StringIO(file.read_text())))
    missed: list[str] = []
    for column, name in enumerate(rows[0]):
        cell = rows[-1][column]
        changed = [list(row) for row in rows]
        if name in ("rung", "verdict"):
            changed[-1][column] = OTHER_LABELS[name]
        elif name == "robot":
            changed[-1][column] = "another"
        elif name == "connected":
            changed[-1][column] = {"1": "0", "0": "1", "": "1"}[cell]
        else:
            changed[-1][column] = repr(float(cell or 0.0) + 0.25)
        file.write_text("\n".join(",".join(row) for row in changed))
        result = judged(folder)
        step = len(rows) - 2
        where = (f"row {step + 2}", f"line {step + 2}", f"{name}[{step}]")
        if not any(name in r and any(w in r for w in where) for r in result.reasons):
            missed.append(f"{name}: {result.verdict}, {result.reasons[:3]}")
    assert missed == []


def test_every_array_is_judged(folder: Path) -> None:
    """Whatever number of the belief is edited, check rejects it and names the array."""
    file = folder / "belief.npz"
    with np.load(file) as archive:
        arrays = dict(archive)
    missed: list[str] = []
    for name, array in arrays.items():
        changed = array.copy()
        if array.dtype.kind == "b":
            changed = np.logical_xor(array, np.arange(array.size).reshape(array.shape) == 0)
        elif array.dtype.kind == "U":
            changed = np.array(["another"]) if array.ndim else np.array("another")
        elif array.ndim == 0:
            changed = np.array(600.0) if np.isinf(array) else array - 1
        elif array.size == 0:
            changed = np.array([len(arrays["power_dbm"])])
        else:
            changed.flat[array.size // 2] += 1
        np.savez(file, **{**arrays, name: changed})
        result = judged(folder)
        if result.verdict is not Verdict.VIOLATED or name not in str(result.reasons):
            missed.append(f"{name}: {result.verdict}, {result.reasons[:3]}")
    np.savez(file, **arrays, more=np.zeros(2))
    assert "more" in str(check(folder).reasons)
    assert missed == []


def test_which_terminations_pass_for_one_another(folders: dict[str, Path]) -> None:
    """Of a polished plan, only those of solvers; each other one is rejected by name."""
    file = json_file(folders["plan"])
    text = file.read_text()
    data = json.loads(text)
    assert data["termination"] == "converged" and data["rung"] == "plan"
    passing: set[str] = set()
    for name in [*Termination, "proven"]:
        data["termination"] = data["robots"][0]["termination"] = str(name)
        file.write_text(json.dumps(data))
        result = check(folders["plan"])
        if result.verdict is Verdict.VERIFIED:
            passing.add(str(name))
        else:
            assert any(f"termination: {name}" in r or f'"{name}"' in r for r in result.reasons)
    file.write_text(text)
    assert passing == {
        "converged",
        "acceptable",
        "iteration_limit",
        "time_limit",
        "infeasible",
        "numerical_failure",
    }


@pytest.mark.parametrize(("key", "name"), [("verdict", "fine"), ("rung", "guess")])
def test_unknown_labels_are_named(folders: dict[str, Path], key: str, name: str) -> None:
    """A name that planopt never gives is rejected with those that it does."""
    for kind in ("plan", "run"):
        file = json_file(folders[kind])
        text = file.read_text()
        data = json.loads(text)
        plan = data["robots"][0] if kind == "plan" else data["plans"][0]["released"][1]
        plan[key] = name
        file.write_text(json.dumps(data))
        result = check(folders[kind])
        file.write_text(text)
        assert result.verdict is Verdict.VIOLATED and len(result.reasons) == 1
        assert f'{key}: "{name}", should be one of' in result.reasons[0]
        assert result.reasons[0].startswith(f"{file.name}, key ")
