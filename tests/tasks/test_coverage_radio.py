"""Networks that keep their links to stations by what a survey has taught."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import planopt
from planopt.cli import main
from planopt.errors import InputError
from planopt.problems.tasks import problem_from

PROBLEM = """
[problem]
schema = 1
name = "surveyed"
task = "coverage"
[world]
bounds_m = [0, 0, 90, 60]
[agents]
start = { kind = "random", count = 8, within_m = [5, 5, 25, 25] }
speed_max_m_s = 3.0
[radio]
stations_m = [[10, 10]]
p_min = 0.95
k_pl_db = -30.0
n_pl = 3.0
deviation_db = 4.0
threshold_dbm = -78.0
[control]
duration_s = 16
coverage_gain_per_s = 0.8
[planner]
name = "receding"
horizon = 3
[report]
figures = false
"""
SIMULATED = "[[radio.survey]]\ncount = 80\nseed = 3\n"


def log(folder: Path, *more: str) -> str:
    """Write a log of 60 powers with a wall's shadow beyond x = 50; its table."""
    rng = np.random.default_rng(4)
    places = rng.random((60, 2)) * (90.0, 60.0)
    away = np.linalg.norm(places - 10.0, axis=1)
    power = -30.0 - 30.0 * np.log10(away) - 25.0 * (places[:, 0] > 50.0) + rng.normal(size=60)
    rows = [f"{x:.2f},{y:.2f},{p:.1f}" for (x, y), p in zip(places, power, strict=True)]
    (folder / "log.csv").write_text("\n".join(("x_m,y_m,power_dbm", *rows, *more)) + "\n")
    return '[[radio.survey]]\nfile = "log.csv"\n'


def test_surveyed_links_are_kept_and_judged(tmp_path, capsys):
    """No move breaks the learnt links, the folder is judged again, and the laws lose them."""
    file = tmp_path / "problem.toml"
    file.write_text(PROBLEM + SIMULATED)
    out = tmp_path / "out"
    assert main(["simulate", str(file), "--out", str(out), "--json"]) in (0, 4)
    found = json.loads(capsys.readouterr().out)
    assert found["faults"] == []
    assert found["metrics"]["cost_last"] < 0.6 * found["metrics"]["cost_first"]
    assert main(["check", str(out)]) == 0
    lost = planopt.simulate(planopt.load(file), planner="law").data["faults"]
    assert lost and all("fault of radio" in each for each in lost)


def test_a_log_teaches_where_links_fail(tmp_path):
    """Direct links are trusted before the wall only, and a saved problem needs no log."""
    table = log(tmp_path)
    (tmp_path / "problem.toml").write_text(PROBLEM + table)
    problem = planopt.load(tmp_path / "problem.toml")
    mapped = problem.station_map
    before, behind = np.array([[30.0, 20.0]]), np.array([[70.0, 20.0]])
    assert mapped.near(before, before)[0, 0] < 0.4
    assert mapped.near(behind, behind)[0, 0] > 0.9
    tables = json.loads(json.dumps(problem.tables()))
    (tmp_path / "log.csv").unlink()
    again = problem_from(tables, folder=tmp_path / "nowhere", file=None)
    np.testing.assert_array_equal(again.station_map.failures, mapped.failures)


@pytest.mark.parametrize(
    ("table", "key", "words"),
    [
        (SIMULATED + SIMULATED, "radio.survey", "2 entries for 1 stations"),
        ("[[radio.survey]]\n", "radio.survey", "exactly one"),
        ('[[radio.survey]]\nfile = "nowhere.csv"\n', "radio.survey[0]", "nowhere.csv|not there"),
        ("[[radio.survey]]\nplaces_m = [[1, 1]]\npower_dbm = []\n", "radio.survey", "one power"),
        (SIMULATED + "decorrelation_m = 0.2\n", "radio.survey[0].decorrelation_m", "cells"),
        ("log", "radio.survey[0]", "abc"),
    ],
)
def test_wrong_surveys_are_named(table, key, words, tmp_path):
    """Each mistake gets one error with its key."""
    if table == "log":
        table = log(tmp_path, "1,2,abc")
    (tmp_path / "problem.toml").write_text(PROBLEM + table)
    with pytest.raises(InputError, match=words) as caught:
        planopt.load(tmp_path / "problem.toml")
    assert caught.value.key is not None and key in caught.value.key
