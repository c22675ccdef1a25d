"""Saved results of every task: what agrees, what an edit changes, and damaged folders."""

import csv
import json
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from refusals import refused
from test_coverage import SMALL
from test_pursuit_design import PLAIN

import planopt
from planopt.problems.library import library_folder
from planopt.tasks import task as tasks

LIBRARY = library_folder()
CASES = {
    "coverage": ("simulate", SMALL),
    "deployment": ("solve", SMALL),
    "pursuit": ("simulate", (LIBRARY / "pursuit_fleeing.toml").read_text()),
    "pursuit among obstacles": ("simulate", (LIBRARY / "pursuit_obstacles.toml").read_text()),
    "design": ("solve", PLAIN),
}
EDITS = 40
ACCEPTED = {"wall_s", "step_s", "termination", "problem_file"}


@pytest.fixture(scope="module", params=CASES)
def saved(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    action, text = CASES[request.param]
    folder = tmp_path_factory.mktemp("saved")
    (folder / "problem.toml").write_text(text)
    problem = planopt.load(folder / "problem.toml")
    result = planopt.simulate(problem) if action == "simulate" else planopt.solve(problem)
    result.save(folder / "out")
    return folder / "out"


def leaves(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The paths of all values that a check does not accept whatever they are."""
    if isinstance(data, dict | list):
        for key in data if isinstance(data, dict) else range(len(data)):
            if key not in ACCEPTED:
                yield from leaves(data[key], (*path, key))
    else:
        yield path


def other(value: Any) -> Any:
    """A value that differs by more than any tolerance."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + max(0.02, abs(value) * 0.02) if isinstance(value, float) else value + 1
    return "other" if isinstance(value, str) else 0.5


def edited_json(file: Path, rng: random.Random) -> str:
    """Change one value of a JSON file; the seed is that of the next test."""
    data = json.loads(file.read_text())
    *path, last = rng.choice([path for path in leaves(data) if path != ("seed",)])
    table = data
    for part in path:
        table = table[part]
    table[last] = other(table[last])
    file.write_text(json.dumps(data))
    return f"{path} {last}"


def edited_cell(file: Path, rng: random.Random) -> str:
    rows = list(csv.reader(file.read_text().splitlines()))
    row, column = rng.randrange(1, len(rows)), rng.randrange(len(rows[0]))
    cell = rows[row][column]
    try:
        number = float(cell) if "." in cell or "e" in cell else int(cell)
        rows[row][column] = str(other(number))
    except ValueError:
        text = rows[0][column] in ("robot", "state", "event", "chases", "pursuer", "evader")
        rows[row][column] = "other" if text else "0.5"
    file.write_text("\n".join(",".join(each) for each in rows) + "\n")
    return f"{file.name} {rows[0][column]} {row}"


def test_no_edit_passes(saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder agrees; with any value changed it is rejected."""
    assert planopt.check(saved).verdict is planopt.Verdict.VERIFIED
    # The same problem and seed give the same result: it is computed once.
    again = {}

    def once(action: str, problem: Any, *, seed: int, **more: Any) -> Any:
        if action not in again:
            again[action] = computed(action, problem, seed=seed, **more)
        return again[action]

    computed = tasks.perform
    monkeypatch.setattr(tasks, "perform", once)
    rng, contents = random.Random(3), {path.name: path.read_text() for path in saved.iterdir()}
    tables = [name for name in contents if name.endswith(".csv") and contents[name].count("\n") > 1]
    for number in range(EDITS):
        for name, text in contents.items():
            (tmp_path / name).write_text(text)
        if tables and number % 2:
            where = edited_cell(tmp_path / rng.choice(tables), rng)
        else:
            where = edited_json(next(tmp_path.glob("*.json")), rng)
        try:
            verdict = planopt.check(tmp_path).verdict
        except planopt.InputError:
            continue
        assert verdict is planopt.Verdict.VIOLATED, where


@pytest.mark.parametrize("name", ["coverage_obstacles", "pursuit_design"])
def test_a_changed_bound_is_rejected(name: str, tmp_path: Path) -> None:
    """The bound and the gap of a deployment and of a design are compared tightly."""
    planopt.solve(planopt.load(name)).save(tmp_path)
    file = tmp_path / "plan.json"
    data = json.loads(file.read_text())
    assert planopt.check(tmp_path).verdict is planopt.Verdict.VERIFIED
    for change in ({"bound": data["bound"] * 1.00001}, {"gap": 0.0}):
        file.write_text(json.dumps({**data, **change}))
        assert planopt.check(tmp_path).verdict is planopt.Verdict.VIOLATED, change


def test_another_seed_or_problem_is_found(saved: Path, tmp_path: Path) -> None:
    """Results are those of the seed and the problem in the file."""
    file = next(saved.glob("*.json"))
    data = json.loads(file.read_text())
    for path in saved.iterdir():
        (tmp_path / path.name).write_text(path.read_text())
    changes: list[dict[str, Any]] = [{"seed": data["seed"] + 1}]
    tables = data["problem_file"]
    if tables["problem"]["task"] == "pursuit":
        rules = {**tables["pursuit"], "capture_radius_m": 40.0}
        changes = [{"problem_file": {**tables, "pursuit": rules}}]
    if tables["problem"]["task"] == "pursuit_design":
        changes = [{"problem_file": {**tables, "design": {**tables["design"], "margin": 0.1}}}]
    for change in changes:
        (tmp_path / file.name).write_text(json.dumps({**data, **change}))
        assert planopt.check(tmp_path).verdict is planopt.Verdict.VIOLATED


def test_results_are_read_back(saved: Path) -> None:
    """A read result has the saved data, tables, words and exit code, and saves the same files."""
    back = planopt.load_result(saved)
    data = json.loads(next(saved.glob("*.json")).read_text())
    assert back.data == {key: value for key, value in data.items() if key != "problem_file"}
    assert back.problem.tables() == data["problem_file"]
    assert back.exit_code == (4 if data.get("outcome") in ("unserved", "not_settled") else 0)
    assert back.words[0].startswith(data["problem"]) and repr(back) == "\n".join(back.words)
    if back.tables:
        frame = back.to_dataframe()
        assert list(frame) == next(csv.reader((saved / "steps.csv").read_text().splitlines()))
    with refused():
        back.plot()


@pytest.mark.parametrize(
    ("file", "change"),
    [
        ("steps.csv", lambda text: text[: len(text) // 2]),
        ("steps.csv", lambda text: text.replace("0.2,", "nan,", 1)),
        ("steps.csv", lambda text: text.replace("x_m", "z_m", 1)),
        ("records.csv", None),
        ("run.json", lambda text: text[:-20]),
    ],
)
def test_damaged_folders(file: str, change: Any, tmp_path: Path) -> None:
    planopt.simulate(planopt.load("pursuit_fleeing")).save(tmp_path)
    text = (tmp_path / file).read_text()
    (tmp_path / file).unlink()
    if change is not None:
        (tmp_path / file).write_text(change(text))
    with refused() as caught:
        planopt.check(tmp_path)
    assert caught.value.file is not None
