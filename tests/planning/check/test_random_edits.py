"""Random edits of single values of saved results, each larger than ten tolerances: none passes."""

import csv
import io
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from team_scene import two_trackers

from planopt import InputError, check, load, simulate, solve
from planopt.files.compare import ACCEPTED, EXACT, TOLERANCES

MANY = 300

LABELS = ("verified", "violated", "reached", "stalled", "step_limit")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan, a run to a goal, and a run of a team that tracks a target."""
    folder, field = tmp_path_factory.mktemp("made"), load("open_field")
    short = replace(field, planner=replace(field.planner, max_steps=4))
    # A threshold that some steps miss, with proof.
    deaf = replace(field, stations=(replace(field.stations[0], threshold_dbm=-48.0),))
    solve(field, horizon=3).save(folder / "plan")
    solve(deaf, horizon=5, seed=1).save(folder / "relaxed")
    simulate(short, horizon=3, seed=1).save(folder / "run")
    simulate(two_trackers(), seed=1).save(folder / "team")
    for each in folder.iterdir():
        assert check(each).reasons == ()
    return folder


def leaves(value: Any, way: tuple[Any, ...] = (), name: str = "") -> Iterator[tuple[Any, ...]]:
    """Yield pattern, way, name and value of every leaf that is not accepted."""
    if name in ACCEPTED or name == "problem_file":
        return
    if not isinstance(value, dict | list):
        pattern = tuple(part for part in way if isinstance(part, str))
        yield pattern, way, name, value
        return
    for part, inner in value.items() if isinstance(value, dict) else enumerate(value):
        yield from leaves(inner, (*way, part), part if isinstance(part, str) else name)


def edited(generator: np.random.Generator, name: str, value: Any) -> Any:
    """Return another value, numbers by more than ten tolerances."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + int(generator.integers(1, 4))
    if isinstance(value, float):
        absolute, relative = TOLERANCES.get(name, EXACT)
        size = 10.0 ** generator.uniform(1.1, 5.0) * max(absolute, relative * abs(value))
        return 600.0 if np.isinf(value) else value + float(generator.choice([-1.0, 1.0])) * size
    if value is None:
        return 0.5
    return next(label for label in LABELS if label != value) if value in LABELS else value + "x"


def edit(generator: np.random.Generator, folder: Path) -> str:
    file = sorted(f for f in folder.iterdir())[generator.integers(len(list(folder.iterdir())))]
    if file.suffix == ".json":
        data = json.loads(file.read_text())
    elif file.suffix == ".npz":
        with np.load(file) as archive:
            arrays = dict(archive)
        data = {name: array.tolist() for name, array in arrays.items()}
    else:
        rows = list(csv.reader(io.StringIO(file.read_text())))
        table = dict(zip(rows[0], zip(*rows[1:], strict=True), strict=True))
        data = {name: [number(cell) for cell in cells] for name, cells in table.items()}
    found = list(leaves(data))
    patterns = sorted({leaf[0] for leaf in found})
    pattern = patterns[generator.integers(len(patterns))]
    alike = [leaf for leaf in found if leaf[0] == pattern]
    _, way, name, value = alike[generator.integers(len(alike))]
    # Gaussian sites are compared in natural units.
    new = value * 1.1 if name in ("values_db", "noise_variance_db2") else None
    new = edited(generator, name, value) if new is None else new
    place = data
    for part in way[:-1]:
        place = place[part]
    place[way[-1]] = new
    if file.suffix == ".json":
        file.write_text(json.dumps(data))
    elif file.suffix == ".npz":
        np.savez(file, **{**arrays, way[0]: np.array(data[way[0]])})
    else:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(data)
        writer.writerows(zip(*data.values(), strict=True))
        file.write_text(text.getvalue())
    return f"{folder.name}/{file.name} {way}: {value!r} -> {new!r}"


def number(cell: str) -> Any:
    """Return a cell's value; None where it is empty."""
    if not cell:
        return None
    try:
        return int(cell) if cell.lstrip("-").isdecimal() else float(cell)
    except ValueError:
        return cell


def passing(made: Path, tmp_path: Path, count: int, seed: int) -> list[str]:
    generator, passed = np.random.default_rng(seed), list[str]()
    names = sorted(each.name for each in made.iterdir())
    for trial in range(count):
        name = names[generator.integers(len(names))]
        folder = Path(shutil.copytree(made / name, tmp_path / str(trial) / name))
        said = edit(generator, folder)
        try:
            reasons = check(folder).reasons
        except InputError as error:
            reasons = (str(error),)
        if not reasons:
            passed.append(said)
        shutil.rmtree(folder)
    return passed


def test_300_random_edits_are_found(made: Path, tmp_path: Path) -> None:
    """Positions, verdicts, certificates, metrics, beliefs, seeds, measurements, deviations."""
    passed = passing(made, tmp_path, MANY, 2)
    assert not passed, "\n".join(passed)
