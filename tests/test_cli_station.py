"""``planopt fit`` with the station's position unknown."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from planopt.cli import main

FITTED = (0, 3)
"""Exit codes of a fit; 3 if the log does not determine the channel."""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Eighty noisy powers along a path loss of exponent 3, station at (120, 60)."""
    generator = np.random.default_rng(8)
    places = generator.uniform(0.0, 200.0, (80, 2))
    distance = np.hypot(*(places - (120.0, 60.0)).T)
    power = -30.0 - 30.0 * np.log10(distance) + generator.normal(0.0, 2.0, 80)
    rows = [f"{x},{y},{p}" for (x, y), p in zip(places, power, strict=True)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["x_m,y_m,power_dbm", *rows]))
    return path


def fitted(log: Path, capsys, *options: str) -> dict:
    """The JSON object that is printed."""
    assert main(["fit", str(log), "--json", *options]) in FITTED
    return json.loads(capsys.readouterr().out)


def test_standard_errors_of_the_station(log: Path, capsys) -> None:
    """Two numbers where it is estimated, by either way; null where it is given."""
    joint = fitted(log, capsys, "--station", "unknown")
    line = fitted(log, capsys, "--station", "unknown", "--station-method", "line")
    given = fitted(log, capsys, "--station", "120,60")
    assert fitted(log, capsys, "--station", "unknown", "--station-method", "joint") == joint
    assert line["station"] != joint["station"]
    assert given["station_standard_errors_m"] is None
    for one in (joint, line):
        errors = one["station_standard_errors_m"]
        assert all(0.0 < error < 10.0 for error in errors)
        assert np.all(np.abs(np.subtract(one["station"], (120.0, 60.0))) < 4.0 * np.array(errors))


def test_in_words(log: Path, capsys) -> None:
    """The station's errors stand beside it, and nothing where it is given."""
    assert main(["fit", str(log), "--station", "unknown"]) in FITTED
    first = capsys.readouterr().out.splitlines()[0]
    assert re.search(r"station \([\d.]+, [\d.]+\) \+- \([\d.]+, [\d.]+\) m$", first)
    assert main(["fit", str(log), "--station", "120,60"]) in FITTED
    assert "station (120, 60) m\n" in capsys.readouterr().out


def test_not_bounded_is_null(tmp_path: Path, capsys) -> None:
    """Powers that rise steadily to one side: errors are null, and the status says so."""
    generator = np.random.default_rng(3)
    places = generator.uniform(0.0, 100.0, (60, 2))
    power = -80.0 + 0.05 * places[:, 0] + np.random.default_rng(4).normal(0.0, 2.0, 60)
    rows = [f"{x},{y},{p}" for (x, y), p in zip(places, power, strict=True)]
    log = tmp_path / "log.csv"
    log.write_text("\n".join(["x_m,y_m,power_dbm", *rows]))
    found = fitted(log, capsys, "--station", "unknown", "--station-method", "line")
    assert found["status"] == "degenerate"
    assert found["station_standard_errors_m"] == [None, None]
    assert found["standard_errors"]["n_pl"] is None
