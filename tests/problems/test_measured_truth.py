"""Measured power as ground truth: the nearest reading, and nothing where none is near."""

from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from scipy.spatial.distance import cdist

import planopt
from planopt.channel.ground_truth import measure, measured_truth, true_power_dbm
from planopt.channel.measurements import Measurements
from planopt.cli import main
from planopt.problems import MeasuredTruth, list_problems, problem_from_dict, problem_to_dict

READINGS = Measurements(
    np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 0.0], [2.0, 3.0]]),
    np.array([-50.0, -60.0, -99.0, -80.0]),
    np.array([False, False, False, True]),
)
SITES = ("campus_courier", "flat_courier", "lab_map")


def test_truth_is_the_nearest_reading_within_reach() -> None:
    """Against all distances; of two readings at one position the first counts."""
    truth = measured_truth(READINGS, (0.0, 0.0, 4.0, 4.0), 0.25, 0.5)
    places = np.random.default_rng(0).uniform(-1.0, 4.0, (500, 2))
    away = cdist(places, READINGS.positions_m)
    expected = READINGS.power_dbm[away.argmin(axis=1)]
    expected[away.min(axis=1) > 0.5] = np.nan
    assert 0.05 < np.isfinite(expected).mean() < 0.5
    np.testing.assert_array_equal(true_power_dbm(truth, places), expected)
    taken = measure(truth, places)
    assert len(taken) == np.isfinite(expected).sum()
    np.testing.assert_array_equal(taken.censored, taken.power_dbm == -80.0)
    assert measure(truth, [[1.0, 1.5]]).power_dbm.size == 0
    assert np.isnan(truth.raster.values[8, 4]) and truth.raster.values[0, 0] == -50.0


def test_courier_drives_through_measured_power(tmp_path: Path) -> None:
    """Powers of the steps are readings of the shipped log, most steps have one, check agrees."""
    problem = planopt.load("flat_courier")
    truth = problem.channel.truth
    assert isinstance(truth, MeasuredTruth)
    assert problem_from_dict(problem_to_dict(problem), file=problem.file) == problem
    run = planopt.simulate(problem, horizon=2)
    log = run.run.log
    rows = np.genfromtxt(truth.file, delimiter=",", names=True, dtype=None, encoding="utf-8")
    own = rows[(rows["anchor"] == 4) & (rows["use"] == "later")]
    away = cdist(log.positions_m, np.column_stack([own["x_m"], own["y_m"]]))
    near = away.min(axis=1) <= 0.5
    np.testing.assert_array_equal(np.isfinite(log.true_dbm), near)
    # Several readings may be equally near.
    tied = np.isclose(away, away.min(axis=1, keepdims=True))
    assert all(log.true_dbm[k] in own["power_dbm"][tied[k]] for k in np.flatnonzero(near))
    assert run.metrics["reading_share"] == near[1:].mean() >= 0.7
    assert run.metrics["true_connected_share"] == log.connected[1:][near[1:]].mean()
    run.save(tmp_path / "run")
    assert main(["check", str(tmp_path / "run")]) == 0


def test_sites_without_their_data_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The error names the variable, and the list says which problems need it."""
    monkeypatch.delenv("PLANOPT_DATA", raising=False)
    lacking = [entry.name for entry in list_problems() if entry.lacks_data]
    assert lacking == [name for name in SITES if name != "flat_courier"]
    for name in lacking:
        with refused() as caught:
            planopt.load(name)
        assert "PLANOPT_DATA" in str(caught.value.remedy)
    assert main(["list"]) == 0
    assert capsys.readouterr().out.count("PLANOPT_DATA") == len(lacking)
    monkeypatch.setenv("PLANOPT_DATA", str(tmp_path))
    assert not any(entry.lacks_data for entry in list_problems())
    with refused() as caught:
        planopt.load("lab_map")
    assert "PLANOPT_DATA" in str(caught.value.remedy)
    monkeypatch.setenv("PLANOPT_DATA", "")
    assert [entry.name for entry in list_problems() if entry.lacks_data] == lacking


def test_workspace_without_any_reading_is_refused() -> None:
    tables = problem_to_dict(planopt.load("flat_courier"))
    tables["channel"]["truth"]["where"] = {"anchor": "4", "use": "later", "drive": "1"}
    tables["channel"]["truth"]["within_m"] = 1e-9
    tables["channel"]["truth"]["cell_m"] = 0.17
    with refused():
        planopt.simulate(problem_from_dict(tables), horizon=1)
