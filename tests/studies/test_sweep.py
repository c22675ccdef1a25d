"""Sweeps over any keys, several problems, their files and their command."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from test_finished_runs import short

import planopt
from planopt import Comparison, InputError, compare, load
from planopt.cli import main
from planopt.commands.compare import seed_range, swept
from planopt.files.tables import encoded
from planopt.planning.loop.results import RunSummary, summary_of
from planopt.planning.solve import simulate
from planopt.problems.library import library_folder
from planopt.problems.load import with_changes
from planopt.report import comparison_text, draw_comparison
from planopt.report.comparison_figure import layout_of
from planopt.studies.comparison import comparison_rows

SWEEP = {"constraints.p_min": [0.5, 0.9], "robots[0].speed_max_m_s": [1.0, 2.0]}


@pytest.fixture(scope="module")
def problem() -> planopt.Problem:
    return short("open_field")


@pytest.fixture(scope="module")
def comparison(problem: planopt.Problem) -> Comparison:
    return compare(problem, costs_to_go=["geodesic"], sweep=SWEEP, seeds=[3, 5])


def untimed(run: RunSummary) -> dict:
    """All values that do not depend on the process that drove the run."""
    data = encoded(run)
    assert len(data.pop("step_s")) == len(run.step_s)
    return data


def test_every_combination_is_that_of_a_changed_problem(problem, comparison) -> None:
    """Setting by setting, seed by seed; the runs are bit for bit those of `simulate`."""
    settings = [(p, v) for p in (0.5, 0.9) for v in (1.0, 2.0)]
    wanted = [(p, v, seed) for p, v in settings for seed in (3, 5)]
    found = [(*run.sweep.values(), run.seed) for run in comparison.runs]
    assert found == wanted and len({run.horizon for run in comparison.runs}) == 1
    changed = replace(
        problem,
        constraints=replace(problem.constraints, p_min=0.9),
        robots=(replace(problem.robots[0], speed_max_m_s=1.0),),
    )
    alone = summary_of(simulate(changed, cost_to_go="geodesic", seed=5))
    [same] = [r for r in comparison.runs if (*r.sweep.values(), r.seed) == (0.9, 1.0, 5)]
    assert untimed(replace(alone, sweep=same.sweep)) == untimed(same)
    slow, fast = (
        next(r for r in comparison.rows if r.metric == "path_m" and tuple(r.sweep.values()) == s)
        for s in ((0.5, 1.0), (0.5, 2.0))
    )
    assert slow.mean < fast.mean and slow.paired_difference == 0.0
    assert fast.paired_difference == pytest.approx(fast.mean - slow.mean)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("constraints.p_min", 0.25),
        ("robots[0].speed_max_m_s", 0.5),
        ("robots[*].speed_max_m_s", 0.5),
        ("channel.fit.method", "nls"),
        ("planner.horizon", 7),
    ],
)
def test_a_key_is_changed_and_nothing_else(key: str, value: object) -> None:
    """As its file would say it; the file that is named in messages stays."""
    problem = load("open_field")
    changed = with_changes(problem, {key: value})
    assert changed.file == problem.file and changed != problem
    table, name = key.replace("[0]", "").replace("[*]", "").rsplit(".", 1)
    part = {
        "constraints": changed.constraints,
        "robots": changed.robots[0],
        "channel.fit": changed.channel,
        "planner": changed.planner,
    }[table]
    assert getattr(part, "fit_method" if name == "method" else name) == value
    original = getattr(problem.robots[0], name, None) or getattr(problem.constraints, name, None)
    original = original or getattr(problem.planner, name, None) or problem.channel.fit_method
    assert with_changes(changed, {key: original}) == problem
    assert with_changes(problem, {}) is problem


@pytest.mark.parametrize(
    "changes",
    [
        {"constraints.p_mim": 0.5},
        {"constraints.p_min": 1.5},
        {"constraints.p_min": "high"},
        {"robots.speed_max_m_s": 1.0},
        {"robots[3].speed_max_m_s": 1.0},
        {"constraints[0].p_min": 1.0},
        {"constraints.p_min.low": 1.0},
        {"constraints..p_min": 1.0},
        {"": 1.0},
        {"robots[0]": 1.0},
    ],
)
def test_wrong_changes(changes) -> None:
    """The error names the key and the value."""
    with refused():
        with_changes(load("open_field"), changes)


def test_other_tasks_are_swept(problem) -> None:
    """Next to a problem of motion planning; capture takes longer against a faster evader."""
    pursuit = planopt.load("pursuit_fleeing")
    speed = "evaders[0].speed_max_m_s"
    found = compare(pursuit, sweep={speed: [0.2, 0.4]}, seeds=2, workers=2)
    alone = planopt.simulate(pursuit, seed=1)
    assert {run.problem for run in found.runs} == {"pursuit_fleeing"}
    slow, fast = (
        [r.metrics["capture_time_s"] for r in found.runs if r.sweep[speed] == v] for v in (0.2, 0.4)
    )
    assert np.all(np.array(slow) < np.array(fast))
    again = compare([pursuit, problem], seeds=[1], costs_to_go=None)
    assert again.runs[0].metrics["capture_time_s"] == alone.data["metrics"]["capture_time_s"]
    assert [run.problem for run in again.runs][1:] == ["open_field"] * 2
    with refused():
        compare(planopt.load("pursuit_design"), [1], seeds=1)


def test_pairs_across_problems(problem, comparison) -> None:
    """Within a problem, unless each has one setting; six seeds have an interval."""
    base = comparison.runs[0]

    def run(name: str, horizon: int, seed: int, value: float) -> RunSummary:
        metrics = {"path_m": value}
        return replace(base, problem=name, sweep={}, horizon=horizon, seed=seed, metrics=metrics)

    lengths = np.random.default_rng(0).normal(20.0, 2.0, (4, 6))
    single = [run(n, 1, s, lengths[k, s]) for k, n in enumerate("ab") for s in range(6)]
    a, b = comparison_rows(single)
    assert a.paired_difference == 0.0
    assert b.paired_difference == pytest.approx(lengths[1].mean() - lengths[0].mean())
    logs = np.log(lengths[1] / lengths[0])
    half = 2.570582 * logs.std(ddof=1) / math.sqrt(6)
    assert (b.ratio_low, b.ratio_high) == pytest.approx(
        (math.exp(logs.mean() - half), math.exp(logs.mean() + half))
    )
    several = [
        run(n, h, s, lengths[2 * k + i, s])
        for k, n in enumerate("ab")
        for i, h in enumerate((1, 5))
        for s in range(6)
    ]
    rows = comparison_rows(several)
    assert [row.paired_difference == 0.0 for row in rows] == [True, False, True, False]
    assert rows[3].paired_difference == pytest.approx(lengths[3].mean() - lengths[2].mean())


def test_problem_without_a_path_is_a_row(problem) -> None:
    """It does not end the others; alone it is no plan."""
    wall = {"world.obstacles": [{"polygon": [[59, -1], [61, -1], [61, 101], [59, 101]]}]}
    cut = replace(with_changes(problem, wall), name="cut_off")
    found = compare([problem, cut], [2], costs_to_go=["geodesic"], seeds=1)
    assert [(run.problem, run.outcome) for run in found.runs][1] == ("cut_off", "no_plan")
    assert found.runs[1].exit_code == 4 and "stalled" in comparison_text(found)
    with pytest.raises(planopt.NoPlanError):
        compare(cut, [2], costs_to_go=["geodesic"], seeds=1)


def test_saved_and_read_back(comparison, tmp_path: Path) -> None:
    """The same runs and rows; the manifest says what makes them again."""
    comparison.save(tmp_path)
    again = planopt.load_result(tmp_path)
    assert isinstance(again, Comparison) and replace(again.problem, file=None) == replace(
        comparison.problem, file=None
    )
    assert again == planopt.load_result(tmp_path) and again.runs == comparison.runs
    assert again.runs[0] != replace(again.runs[0], connected=~again.runs[0].connected)
    assert repr(again.rows) == repr(comparison.rows)
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["seeds"] == [3, 5] and len(manifest["settings"]) == 4
    assert {"planopt", "source", "numpy", "casadi"} <= set(manifest["program"])
    assert manifest["machine"]["cores"] >= 1 and manifest["machine"]["cpu"]
    lines = [json.loads(line) for line in (tmp_path / "runs.jsonl").read_text().splitlines()]
    assert [line["seed"] for line in lines] == [3, 5] * 4
    assert lines[0]["metrics"]["goal_time_s"] is None
    (tmp_path / "runs.jsonl").write_text("{}\n")
    with refused():
        planopt.load_result(tmp_path / "comparison.json")
    (tmp_path / "runs.jsonl").write_text("")
    with refused():
        planopt.load_result(tmp_path)


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("comparison.json", '"count": 2', '"count": 3', "].count: 3, recomputed 2"),
        ("comparison.json", '"connected_share": ', '"connected_share": 1', "connected_share"),
        ("comparison.json", '"path_m": ', '"path_m": 1', "key runs[0].metrics.path_m"),
        ("runs.jsonl", '"reason": "', '"reason": "not ', "comparison.json, key digest"),
        ("manifest.json", '"seeds": [3', '"seeds": [4', "manifest.json, key seeds[0]"),
    ],
)
def test_edited_comparisons_are_rejected(comparison, tmp_path: Path, file, old, new, words) -> None:
    """Tables are made again from the runs, which a digest covers."""
    comparison.save(tmp_path)
    assert planopt.check(tmp_path).verdict is planopt.Verdict.VERIFIED
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new, 1))
    result = planopt.check(tmp_path)
    assert result.verdict is planopt.Verdict.VIOLATED
    assert any(words in reason for reason in result.reasons), result.reasons


def test_as_a_table(comparison, tmp_path: Path) -> None:
    """A row a run; Parquet has the same columns."""
    frame = comparison.to_dataframe()
    assert frame["constraints.p_min"].tolist() == [0.5] * 4 + [0.9] * 4
    assert frame["path_m"].tolist() == [run.metrics["path_m"] for run in comparison.runs]
    parquet = pytest.importorskip("pyarrow.parquet")
    comparison.save(tmp_path, parquet=True)
    table = parquet.read_table(tmp_path / "runs.parquet")
    assert table.column_names == list(frame.columns)
    assert table["path_m"].to_pylist() == frame["path_m"].tolist()
    assert table["step_s"].to_pylist() == [run.step_s.tolist() for run in comparison.runs]


def test_the_swept_key_stands_along_the_picture(comparison) -> None:
    """If there is one horizon; the other key tells the series apart."""
    layout = layout_of(comparison)
    assert layout.label == "constraints.p_min"
    assert {slot.label for slot in layout.slots} == {
        f"speed_max_m_s = {speed:.1f}, geodesic cost-to-go, planner auto" for speed in (1, 2)
    }
    figure = draw_comparison(comparison)
    ticks = {tuple(t.get_text() for t in axes.get_xticklabels()) for axes in figure.axes}
    assert ticks == {("0.5", "0.9")}
    assert {axes.get_xlabel() for axes in figure.axes} == {"constraints.p_min"}


def test_the_command(tmp_path: Path, capsys) -> None:
    """Two files, a sweep and a range of seeds; the same again is resumed."""
    text = (library_folder() / "open_field.toml").read_text()
    text = text.replace("max_steps = 200", "max_steps = 2").replace(
        "figures = true", "figures = false"
    )
    files = [tmp_path / "a.toml", tmp_path / "b.toml"]
    files[0].write_text(text)
    files[1].write_text(text.replace('name = "open_field"', 'name = "other_field"'))
    command = ["compare", *map(str, files), "--sweep", "objective.cost_to_go=geodesic"]
    command += ["--sweep", "constraints.p_min=0.5,0.8", "--seeds", "4:6", "--horizons", "1"]
    command += ["--out", str(tmp_path / "out")]
    assert main([*command, "--json"]) == 4
    found = json.loads(capsys.readouterr().out)
    assert [(r["problem"], r["sweep"]["constraints.p_min"], r["seed"]) for r in found["runs"]] == [
        (name, p, seed)
        for name in ("open_field", "other_field")
        for p in (0.5, 0.8)
        for seed in (4, 5)
    ]
    assert main([*command, "--workers", "2"]) == 4
    words = capsys.readouterr().out
    assert "8 runs were reused" in " ".join(words.split())
    assert "constraints.p_min" in words and max(map(len, words.splitlines())) <= 100


def test_words_of_the_command() -> None:
    """Sweeps as in a problem file or plain, ranges and numbers of seeds."""
    assert swept("a.b=0.5, 0.8,0.5") == ("a.b", [0.5, 0.8])
    assert swept("a.b=auto,lattice") == ("a.b", ["auto", "lattice"])
    assert swept("a.b=auto,3") == ("a.b", ["auto", 3])
    assert swept("a.b=[1, 2],[3, 4]") == ("a.b", [[1, 2], [3, 4]])
    assert swept('a.b="x,y",true') == ("a.b", ["x,y", True])
    for wrong in ("a.b", "=1", "a.b=", "a.b=1,,2", "a.b=x,"):
        with refused():
            swept(wrong)
    assert seed_range("30", None) == range(30) and seed_range("2", 5) == range(5, 7)
    assert seed_range("100:200", None) == range(100, 200)
    for text, first in (("5:5", None), ("a", None), ("-1:4", None), ("1:2:3", None), ("1:3", 4)):
        with pytest.raises(InputError):
            seed_range(text, first)
