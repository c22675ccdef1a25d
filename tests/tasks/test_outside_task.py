"""A task of another package: the one of docs/extend.md, installed as a distribution."""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from refusals import refused

import planopt
from planopt.cli import main
from planopt.problems import tasks

PAGE = Path(__file__).parents[2] / "docs" / "extend.md"
PROBLEM = """
[problem]
schema = 1
name = "short_walk"
task = "walk"
[walk]
step_m = 1.0
radius_m = 4.0
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A problem file of the installed task."""
    code = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), flags=re.M | re.S)
    site = tmp_path / "site"
    info = site / "walk_task-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "walk_task.py").write_text(next(text for text in code if "TASK = Task(" in text))
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: walk-task\nVersion: 1.0\n")
    points = (
        "[planopt.tasks]\nwalk = walk_task:TASK\nbroken = walk_task:nothing\nodd = json:dumps\n"
    )
    (info / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(site)
    vars(tasks.TASKS).pop("installed", None)
    problem = tmp_path / "walk.toml"
    problem.write_text(PROBLEM)
    yield problem
    monkeypatch.undo()
    vars(tasks.TASKS).pop("installed", None)


def test_every_function_takes_it(file: Path, tmp_path: Path) -> None:
    """Load, solve, simulate, compare, check and read back."""
    problem = planopt.load(file)
    assert (problem.name, problem.task) == ("short_walk", "walk")
    assert planopt.solve(problem).data["steps"] == 16.0
    steps: list[int] = []
    run = planopt.simulate(problem, seed=3, on_step=lambda *_: steps.append(1))
    assert run.exit_code == 0 and run.words == ("short_walk: left",)
    assert len(steps) == run.data["metrics"]["steps"] == len(run.step_s)
    assert list(run.to_dataframe()) == ["step", "x_m", "y_m"]
    with refused():
        planopt.simulate(problem, horizon=2)
    run.save(tmp_path / "out")
    assert planopt.check(tmp_path / "out").verdict is planopt.Verdict.VERIFIED
    back = planopt.load_result(tmp_path / "out")
    assert back.data == run.data and back.exit_code == 0
    data = json.loads((tmp_path / "out" / "run.json").read_text())
    (tmp_path / "out" / "run.json").write_text(json.dumps({**data, "seed": 4}))
    assert planopt.check(tmp_path / "out").verdict is planopt.Verdict.VIOLATED
    found = planopt.compare(problem, sweep={"walk.radius_m": [3.0, 6.0]}, seeds=4)
    near, far = ([r.metrics["steps"] for r in found.runs[i : i + 4]] for i in (0, 4))
    assert sum(near) < sum(far)


def test_a_result_better_than_its_bound_is_rejected(file: Path, tmp_path: Path) -> None:
    """The check rejects a negative gap, even if it is repeated."""
    module = tmp_path / "site" / "walk_task.py"
    text = module.read_text()
    module.write_text(text.replace('"steps": steps})', '"steps": steps, "gap": -0.01})'))
    assert module.read_text() != text
    sys.modules.pop("walk_task", None)
    planopt.solve(planopt.load(file)).save(tmp_path / "out")
    found = planopt.check(tmp_path / "out")
    assert found.verdict is planopt.Verdict.VIOLATED and "better than its" in found.reasons[0]
    sys.modules.pop("walk_task", None)


def test_every_command_takes_it(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "out")
    for command, code, words in (
        (["simulate", str(file), "--seed", "3", "--out", out], 0, "short_walk: left"),
        (["check", out], 0, "verified"),
        (["solve", str(file)], 0, "short_walk: verified"),
        (["compare", str(file), "--sweep", "walk.radius_m=3,6", "--seeds", "2"], 0, "steps"),
        (["show", str(file)], 0, "task        walk"),
        (["validate", str(file)], 0, "valid"),
        (["bench", "run", "--problems", str(file), "--out", f"{out}/bench"], 0, "4 cases finished"),
        (["bench", "report", f"{out}/bench", "--no-page"], 0, "walk"),
        (["schema", "--task", "walk"], 0, "Radius of the circle"),
        (["simulate", str(file), "--animation", "--out", out], 2, "is not available for"),
        (["simulate", str(file), "--planner", "auto"], 2, "is not an option of the task walk"),
    ):
        assert main(command) == code
        captured = capsys.readouterr()
        assert words in captured.out + captured.err


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("step_m = 1.0", "step_m = -1.0"),
        ('"walk"\n[', '"broken"\n['),
        ('"walk"\n[', '"odd"\n['),
        ('"walk"\n[', '"run"\n['),
    ],
)
def test_faults_are_named(file: Path, old: str, new: str) -> None:
    """A value out of range, a task that cannot be imported or is none, an unknown one."""
    assert old in PROBLEM
    file.write_text(PROBLEM.replace(old, new))
    with refused():
        planopt.load(file)
