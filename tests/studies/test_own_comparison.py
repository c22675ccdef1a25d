"""Comparisons that a problem file carries: what they run, and what is seen of them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import refused, refused_command
from test_finished_runs import short

import planopt
from planopt import Comparison, compare, load, load_result
from planopt.cli import main
from planopt.problems import problem_from_dict, problem_to_dict
from planopt.problems.library import library_folder
from planopt.problems.load import with_changes
from planopt.problems.settings import ComparisonSettings, SettingGroup, planner_kind
from planopt.report import comparison_text, draw_comparison
from planopt.report.comparison_figure import layout_of
from planopt.studies.compare import Lists, settings_of
from planopt.studies.comparison import run_columns, short_keys
from planopt.studies.study import run_key

GIVEN = "channel.fit.given"
GROUPS = (
    SettingGroup(),
    SettingGroup(sweep={f"{GIVEN}.n_pl": [1.0, 3.0]}),
    SettingGroup(sweep={f"{GIVEN}.k_pl_db": [-5.0]}),
)
WANTED = [{}, {f"{GIVEN}.n_pl": 1.0}, {f"{GIVEN}.n_pl": 3.0}, {f"{GIVEN}.k_pl_db": -5.0}]


@pytest.fixture(scope="module")
def problem() -> planopt.Problem:
    own = ComparisonSettings(seeds="100:105", settings=GROUPS)
    return replace(load("fig1"), compare=own)


@pytest.fixture(scope="module")
def comparison(problem: planopt.Problem) -> Comparison:
    return compare(problem)


def test_groups_stand_one_after_the_other(problem, comparison) -> None:
    """On the seeds of the problem; each run is that of the changed problem, bit for bit."""
    assert [(run.sweep, run.seed) for run in comparison.runs] == [
        (sweep, seed) for sweep in WANTED for seed in range(100, 105)
    ]
    for sweep in WANTED:
        alone = compare(with_changes(problem, sweep), [1], seeds=[103])
        (one,) = (run for run in comparison.runs if (run.sweep, run.seed) == (sweep, 103))
        np.testing.assert_equal(one.metrics, alone.runs[0].metrics)


def test_explicit_settings_and_seeds_come_first(problem) -> None:
    """Seeds alone replace the problem's; settings replace the whole table."""
    assert [run.seed for run in compare(problem, seeds=[7]).runs] == [7] * 4
    own = settings_of([problem], Lists())
    assert len(own) == 4 and len(settings_of([problem], Lists([1, 2]))) == 2
    other = replace(problem, name="other")
    assert len(settings_of([problem, other], Lists())) == 2


def test_what_is_compared_decides_no_run(problem, comparison, tmp_path: Path) -> None:
    """Keys of runs are the same; tables and results come back from files."""
    assert run_key(problem, 1) == run_key(replace(problem, compare=None), 1)
    tables = problem_to_dict(problem)
    assert problem_from_dict(json.loads(json.dumps(tables))).compare == problem.compare
    assert "compare" not in problem_to_dict(replace(problem, compare=None))
    comparison.save(tmp_path)
    again = load_result(tmp_path)
    assert isinstance(again, Comparison) and [run.sweep for run in again.runs] == [
        run.sweep for run in comparison.runs
    ]
    columns = run_columns(comparison)
    assert columns[f"{GIVEN}.n_pl"][::5] == [None, 1.0, 3.0, None]


def test_a_setting_is_there_once(problem) -> None:
    """The same values in two groups are a slip."""
    twice = replace(problem, compare=ComparisonSettings(settings=(*GROUPS, GROUPS[1])))
    with refused() as caught:
        compare(twice)
    assert caught.value.key == "compare.settings[3]"


@pytest.mark.parametrize("number", ["1", "2", "3", "4", "5", "5_wide"])
def test_every_figure_is_one_command(number: str) -> None:
    """The paper's figures carry their comparisons, of several settings that are allowed."""
    problem = load(f"fig{number}")
    assert problem.compare is not None and len(settings_of([problem], Lists())) >= 4


def test_only_problems_with_settings_compare_without(capsys, tmp_path: Path) -> None:
    """The command of a figure needs no option; another says what to give."""
    text = (library_folder() / "fig1.toml").read_text()
    head = text[: text.index("[compare]")]
    group = '[[compare.settings]]\nsweep = { "channel.fit.given.n_pl" = [2.0, 1.0] }\n'
    own, bare = tmp_path / "own.toml", tmp_path / "bare.toml"
    own.write_text(f"{head}[compare]\nseeds = 2\n{group}")
    bare.write_text(head)
    assert main(["compare", str(own), "--json"]) == 0
    assert [run["seed"] for run in json.loads(capsys.readouterr().out)["runs"]] == [0, 1, 0, 1]
    refused_command(capsys, "compare", bare)
    own.write_text(f"{head}[compare]\n{group.replace('n_pl', 'n_lp')}")
    refused_command(capsys, "validate", own)
    own.write_text(f"{head}[compare]\nseeds = '5:5'\n{group}")
    refused_command(capsys, "validate", own)


@pytest.mark.parametrize(
    "table",
    [
        {"seeds": "x"},
        {"seeds": 0},
        {"seeds": "5:5"},
        {"sweep": {"compare.seeds": [1]}},
        {"sweep": {"problem.name": ["a"]}},
        {"sweep": {"constraints.p_min": 0.5}},
    ],
)
def test_wrong_tables_of_a_comparison(problem, table) -> None:
    """The key of the table, in words of ours."""
    sweep, seeds = table.get("sweep", {"constraints.p_min": [0.5]}), table.get("seeds", 3)
    tables = problem_to_dict(replace(problem, compare=None))
    with refused():
        problem_from_dict({**tables, "compare": {"seeds": seeds, "settings": [{"sweep": sweep}]}})


@pytest.mark.parametrize("group", [{"horizons": (0,)}, {"planners": ("nowhere",)}])
def test_errors_of_settings_name_their_group(problem, group) -> None:
    """The table and the key within the problem that a setting breaks."""
    own = ComparisonSettings(settings=(SettingGroup(), SettingGroup(**group)))
    with refused():
        settings_of([replace(problem, compare=own, file=None)], Lists())


def test_what_changes_no_run_is_not_swept(problem) -> None:
    """By an argument, too; and groups of settings are of their class."""
    with refused():
        compare(problem, sweep={"problem.name": ["a", "b"]}, seeds=1)
    with refused():
        ComparisonSettings(settings=({"horizons": [1]},))
    with refused():
        SettingGroup(sweep={1: [2]})  # type: ignore[dict-item]


def test_known_path_loss_has_no_uncertainty_to_show(comparison) -> None:
    """Its logarithms are no numbers: nowhere is the floor of a logarithm shown as a value."""
    for metric in ("trace_m_db", "log_det_m"):
        assert all(np.isnan(run.metrics[metric]) for run in comparison.runs)
        assert all(row.mean is None for row in comparison.rows if row.metric == metric)
    text = comparison_text(comparison)
    assert "tr M" not in text and "log det" not in text and "-300" not in text
    drawn = [axes.get_title("left") for axes in draw_comparison(comparison).axes]
    assert "RMS map error" in drawn and not any("M" in words.split() for words in drawn)


def test_settings_with_several_keys_are_numbered(comparison) -> None:
    """In words once, with distinct short keys; every paired difference has its interval."""
    text = comparison_text(comparison)
    assert "      2  n_pl = 1.0, planner one_step, horizon 1" in text
    assert f"n_pl is {GIVEN}.n_pl" in text
    assert max(map(len, text.splitlines())) <= 100
    paired = text[text.index("mean differences") :].splitlines()
    (line,) = (one for one in paired[:9] if one.startswith("      4"))
    rows = {(str(row.sweep), row.metric): row for row in comparison.rows}
    row = rows[str(WANTED[3]), "rms_db"]
    assert row.paired_difference is not None and f"{row.paired_difference:+.2f} (" in line
    # Wrong parameters change no path here, which is said, not left out.
    assert "equal in all settings: " in text
    assert layout_of(comparison).ticks == ("1", "2", "3", "4")
    (run, *_) = comparison.runs
    sweep = dict.fromkeys(("robots[0].speed_max_m_s", "robots[1].speed_max_m_s", "planner.step_s"))
    assert list(short_keys([replace(run, sweep=sweep)]).values()) == [
        "robots[0].speed_max_m_s",
        "robots[1].speed_max_m_s",
        "step_s",
    ]
    assert short_keys([replace(run, sweep={"planner.step_s": 1})]) == {
        "planner.step_s": "planner.step_s"
    }


@pytest.fixture(scope="module")
def bounded() -> Comparison:
    problem = short("fig5", steps=4)
    return compare(problem, [1, 2], planners=["auto", "oracle_log"], seeds=5)


def test_bounds_are_run_once_without_horizon(bounded) -> None:
    """They foresee the whole run; bands stand behind NIS and have no panel and no column."""
    assert planner_kind("oracle_log").foresees
    assert [run.planner for run in bounded.runs[::5]] == ["auto", "auto", "oracle_log"]
    assert layout_of(bounded).ticks == ("1", "2", "whole run")
    lines = [line for line in comparison_text(bounded).splitlines() if line[:10] == "oracle_log"]
    assert lines and all(line.split()[1] == "-" for line in lines)
    figure = draw_comparison(bounded)
    (panel,) = (axes for axes in figure.axes if "NIS" in axes.get_title("left"))
    assert len(panel.patches) == 3
    rows = {row.metric: row.mean for row in bounded.rows if row.planner == "oracle_log"}
    last = panel.patches[-1]
    assert last.get_y() == rows["nis_low"]
    assert last.get_y() + last.get_height() == pytest.approx(rows["nis_high"])
    text = comparison_text(bounded)
    assert f"{rows['nis']:.2f}, {rows['nis_low']:.2f} to {rows['nis_high']:.2f}" in text
    assert "least NIS" not in text and "nis low" not in text
