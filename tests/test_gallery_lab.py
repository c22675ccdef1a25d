"""The gallery page of the lab data, run on a stand-in and without any data."""

import runpy
from pathlib import Path

import numpy as np
import pytest

PAGE = Path(__file__).parents[1] / "docs" / "gallery" / "plot_lab.py"
TRUE = np.array([[1.0, 1.0], [4.0, 2.0], [2.0, 4.0]])


@pytest.fixture
def beside(tmp_path: Path, monkeypatch) -> Path:
    monkeypatch.setenv("PLANOPT_DATA", str(tmp_path))
    return tmp_path / "lab"


def test_stand_in(beside: Path, capsys) -> None:
    """Without data a word and no figure; with three transmitters the figure and numbers."""
    page = runpy.run_path(str(PAGE))
    assert "figure" not in page
    assert "no figure" in capsys.readouterr().out
    beside.mkdir(parents=True)
    rng = np.random.default_rng(0)
    places = [f"{k},{k:03d},{x},{y},40" for k, (x, y) in enumerate(TRUE)]
    rows = []
    for number, true in enumerate(TRUE):
        measured = rng.uniform(0.0, 5.0, (40, 2))
        distance = np.hypot(*(measured - true).T)
        power = np.round(-30.0 - 25.0 * np.log10(distance) + rng.normal(0.0, 1.0, 40))
        rows += [f"{number},{x},{y},{p:g}" for (x, y), p in zip(measured, power, strict=True)]
    (beside / "transmitters.csv").write_text("\n".join(["# a", "tx_id,name,x_m,y_m,n", *places]))
    (beside / "dcm_rssi.csv").write_text("\n".join(["# a", "tx_id,x_m,y_m,power_dbm", *rows]))
    page = runpy.run_path(str(PAGE))
    error_m = np.hypot(*(page["estimates"]["joint likelihood"] - TRUE).T)
    assert np.median(error_m) < 0.5
    assert len(page["figure"].axes) == 2
    printed = capsys.readouterr().out
    assert "of 3 inside; not bounded: 0" in printed and "strongest power" in printed
