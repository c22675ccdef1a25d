"""Fig. 5 on a measured log: a stand-in for the data set, and none."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from planopt import InputError

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "fig5_lab.py"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two transmitters in the files' own format."""
    rng = np.random.default_rng(0)
    rows = []
    for number, x in ((0, 0.0), (7, 4.0)):
        measured = rng.uniform(0.0, 5.0, (60, 2))
        distance = np.maximum(np.hypot(measured[:, 0] - x, measured[:, 1]), 0.2)
        power = np.round(-30.0 - 20.0 * np.log10(distance) + rng.normal(0.0, 1.5, 60))
        rows += [f"{number},{a},{b},{p:g}" for (a, b), p in zip(measured, power, strict=True)]
    places = ["# a", "tx_id,name,x_m,y_m,n", "0,00,0.0,0.0,60", "7,07,4.0,0.0,60"]
    (tmp_path / "transmitters.csv").write_text("\n".join(places))
    (tmp_path / "dcm_rssi.csv").write_text("\n".join(["# a", "tx_id,x_m,y_m,power_dbm", *rows]))
    return tmp_path


def test_the_truth_is_what_was_measured(folder: Path) -> None:
    """Each cell has the power measured nearest to it, and nothing else."""
    problem = SCRIPT["lab_problem"](folder, 7, -38.0)
    assert problem.stations[0].position_m == (4.0, 0.0)
    log = np.loadtxt(folder / "dcm_rssi.csv", delimiter=",", skiprows=2)[60:]
    truth = problem.channel.truth
    for iy, ix in ((0, 0), (11, 30), (40, 7)):
        away = np.hypot(log[:, 1] - truth.x_m[ix], log[:, 2] - truth.y_m[iy])
        assert truth.power_dbm[iy, ix] == log[away.argmin(), 3]


@pytest.mark.parametrize(
    ("breaks", "words"),
    [
        (lambda folder: (folder / "dcm_rssi.csv").unlink(), "cannot be read"),
        (lambda folder: (folder / "transmitters.csv").write_text("a\nb\nc,d,e"), "cannot be read"),
        (lambda folder: None, "has no measurements of transmitter 3"),
    ],
)
def test_without_the_data(folder: Path, breaks, words: str, capsys) -> None:
    """An error of planopt's own says what to give."""
    breaks(folder)
    with pytest.raises(InputError, match=words):
        SCRIPT["lab_problem"](folder, 3, -38.0)
    assert SCRIPT["main"]([str(folder), "--transmitter", "3"]) == 2
    assert words in capsys.readouterr().err
