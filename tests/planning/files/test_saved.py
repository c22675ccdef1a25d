"""Plans and runs as folders."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planopt import InputError, Run, Solution
from planopt.planning.files.belief_file import known_before_steps
from planopt.planning.files.run_tables import KNOWLEDGE_COLUMNS, STEP_COLUMNS
from planopt.planning.files.saved import read_object, saved_from

HEADER = (
    "robot,step,t_s,x_m,y_m,predicted_db,deviation_db,connectivity,true_db,connected,rung,verdict"
)


def test_a_plan_has_the_files_of_the_contract(plan_folder: Path, solution: Solution) -> None:
    """JSON with the problem, a table with the contract's columns, truth empty, no other file."""
    assert {f.name for f in plan_folder.iterdir()} == {"plan.json", "steps.csv", "belief.npz"}
    lines = (plan_folder / "steps.csv").read_text().splitlines()
    assert lines[0] == HEADER and len(lines) == 8
    rows = list(csv.DictReader(lines))
    assert [float(row["x_m"]) for row in rows] == solution.plan.positions_m[:, 0].tolist()
    assert {(row["true_db"], row["connected"]) for row in rows} == {("", "")}
    data = json.loads((plan_folder / "plan.json").read_text())
    assert data["problem_file"]["planner"]["horizon"] == 6


def test_a_run_has_the_files_of_the_contract(run_folder: Path, simulation: Run) -> None:
    """The table has the truth; the JSON has every released plan."""
    assert {f.name for f in run_folder.iterdir()} == {"run.json", "steps.csv", "belief.npz"}
    rows = list(csv.DictReader((run_folder / "steps.csv").read_text().splitlines()))
    assert [float(row["true_db"]) for row in rows] == simulation.run.log.true_dbm.tolist()
    assert {row["connected"] for row in rows} <= {"0", "1"}
    assert len(json.loads((run_folder / "run.json").read_text())["plans"][0]["released"]) == 8


def test_each_step_knows_what_was_measured_before_it(simulation: Run) -> None:
    """A step's count grows by one after a step that ended where something was measured."""
    track = simulation.run.log.positions_m
    known = known_before_steps(simulation.belief, simulation.first_measurements, [track])
    taken = simulation.belief.posterior.measurements.positions_m[simulation.first_measurements :]
    track = simulation.run.log.positions_m[1:]
    measured = [bool((taken == place).all(axis=1).any()) for place in track]
    assert known[0] == simulation.first_measurements
    assert np.diff(known).tolist() == [int(m) for m in measured[:-1]]
    assert known[-1] + int(measured[-1]) == len(simulation.belief.posterior.measurements)


def edit(name: str, change: Callable[[dict], object]) -> Callable[[Path], object]:
    """Damage one key of a JSON file."""

    def damage(folder: Path) -> None:
        data = json.loads((folder / name).read_text())
        change(data)
        (folder / name).write_text(json.dumps(data))

    return damage


def text(name: str, change: Callable[[str], str]) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_text(change((folder / name).read_text()))


def first(data: dict) -> dict:
    return data["robots"][0]


def plan_of(data: dict) -> dict:
    """The second released plan of a run."""
    return data["plans"][0]["released"][1]


PLAN, RUN, STEPS, ROW = "plan.json", "run.json", "steps.csv", "rover,0,0.0,"

# File, key and damage.
DAMAGE = [
    (None, None, lambda folder: (folder / PLAN).unlink()),
    (STEPS, None, lambda folder: (folder / STEPS).unlink()),
    ("belief.npz", None, lambda folder: (folder / "belief.npz").unlink()),
    (PLAN, None, text(PLAN, lambda t: t[:500])),
    (PLAN, None, text(PLAN, lambda t: "")),
    (PLAN, None, text(PLAN, lambda t: "[1]")),
    (PLAN, None, text(PLAN, lambda t: "[" * 100_000)),
    (PLAN, "verdict", text(PLAN, lambda t: t.replace("{", '{"verdict": "verified", ', 1))),
    (PLAN, "seed", edit(PLAN, lambda d: d.pop("seed"))),
    (PLAN, "robots[0].rung", edit(PLAN, lambda d: first(d).update(rung=1))),
    (PLAN, "robots[0].rung", edit(PLAN, lambda d: first(d).update(rung="guess"))),
    (PLAN, "robots[0]", edit(PLAN, lambda d: d["problem_file"]["planner"].update(horizon=9))),
    (PLAN, "robots[0].x_m[1]", edit(PLAN, lambda d: first(d)["x_m"].__setitem__(1, "a"))),
    (PLAN, "robots[0].x_m[0]", text(PLAN, lambda t: t.replace("[32.0,", "[NaN,", 1))),
    (PLAN, "robots[0]", edit(PLAN, lambda d: first(d)["y_m"].pop())),
    (PLAN, "problem_file", edit(PLAN, lambda d: d.pop("problem_file"))),
    (
        PLAN,
        "robots[0].speed_max_m_s",
        edit(PLAN, lambda d: first(d["problem_file"]).update(speed_max_m_s=-1)),
    ),
    (STEPS, None, text(STEPS, lambda t: t.rstrip()[:-20])),
    (STEPS, None, text(STEPS, lambda t: t.replace("x_m", "x"))),
    (STEPS, "x_m", text(STEPS, lambda t: t.replace(f"{ROW}32.0", f"{ROW}here"))),
    (STEPS, "x_m", text(STEPS, lambda t: t.replace(f"{ROW}32.0", f"{ROW}inf"))),
    (STEPS, "x_m", text(STEPS, lambda t: t.replace(f"{ROW}32.0", ROW))),
    (STEPS, None, lambda folder: (folder / STEPS).write_bytes(b"\xff\xfe\x00")),
    (STEPS, None, text(STEPS, lambda t: "")),
    (RUN, "plans", edit(RUN, lambda d: d["plans"].pop())),
    (RUN, "format", edit(RUN, lambda d: d.update(format=2))),
    (RUN, "plans[0].released[1]", edit(RUN, lambda d: plan_of(d)["y_m"].pop())),
    (
        RUN,
        "plans[0].released[1]",
        edit(RUN, lambda d: [plan_of(d)[key].pop() for key in ("x_m", "y_m")]),
    ),
    (RUN, "seed", edit(RUN, lambda d: d.update(seed=-1))),
]


@pytest.mark.parametrize(("file", "key", "damage"), DAMAGE)
def test_damage_is_an_error(plan_folder: Path, run_folder: Path, file, key, damage) -> None:
    """Missing, truncated and wrong files are errors that name file and key."""
    folder = run_folder if file == RUN else plan_folder
    damage(folder)
    with pytest.raises(InputError) as raised:
        saved_from(*read_object(folder))
    assert raised.value.file == str(folder if file is None else folder / file)
    assert raised.value.key == key


def test_columns_are_documented() -> None:
    """The page of files has the columns as they are declared."""
    page = (Path(__file__).parents[3] / "docs" / "files.md").read_text()
    for columns in (STEP_COLUMNS, KNOWLEDGE_COLUMNS):
        assert "\n".join(f"| `{c.name}` | {c.unit} | {c.meaning} |" for c in columns) in page
