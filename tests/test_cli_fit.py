"""``planopt fit``: results, options and pictures."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from refusals import refused_command

from planopt.cli import main

CONTRACT = {
    *("method", "status", "k_pl_db", "n_pl", "shadow_std_db", "decorrelation_m"),
    *("multipath_std_db", "station", "standard_errors", "measurements", "censored", "warnings"),
}


FITTED = (0, 3)
"""Exit codes of a fit; 3 if the log does not determine the channel."""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Sixty noisy powers along a path loss of exponent 3, station at (0, 0), floor -95 dBm."""
    generator = np.random.default_rng(8)
    places = generator.uniform(10.0, 200.0, (60, 2))
    power = -30.0 - 30.0 * np.log10(np.hypot(*places.T)) + generator.normal(0.0, 1.0, 60)
    rows = [
        f"{x:.3f},{y:.3f},{max(p, -95.0):.3f},{int(p <= -95.0)}"
        for (x, y), p in zip(places, power, strict=True)
    ]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["east,north,rssi,low", *rows]))
    return path


COLUMNS = ["--columns", "x=east,y=north,power=rssi"]


def test_fit_prints_the_keys_of_the_contract(log: Path, capsys) -> None:
    """The exponent is found to within its error; every standard error is a number or null."""
    arguments = ["fit", str(log), "--station", "0,0,0.5", *COLUMNS, "--censored", "low"]
    assert main([*arguments, "--json"]) in FITTED
    printed = capsys.readouterr()
    data = json.loads(printed.out)
    assert printed.err == "" and set(data) >= CONTRACT
    assert abs(data["n_pl"] - 3.0) < 0.5
    assert data["station"] == [0.0, 0.0] and data["measurements"] == 60
    assert 0 < data["censored"] < 60
    assert set(data["standard_errors"]) < CONTRACT


def test_fit_says_what_is_hardly_determined(tmp_path: Path, capsys) -> None:
    """Status, text and JSON agree.

    Thirty powers along 60 m whose shadowing forgets over 200 m: no distance is too long.
    """
    generator = np.random.default_rng(4)
    x = np.linspace(100.0, 160.0, 30)
    covariance = 36.0 * np.exp(-np.abs(x[:, None] - x) / 200.0) + np.eye(30)
    power = -30.0 - 30.0 * np.log10(x) + np.linalg.cholesky(covariance) @ generator.normal(size=30)
    path = written(tmp_path / "log.csv", np.stack([x, 0.0 * x], axis=1), power)
    assert main(["fit", str(path), "--station", "0,0", "--json"]) in FITTED
    data = json.loads(capsys.readouterr().out)
    assert data["status"] != "ok"
    assert main(["fit", str(path), "--station", "0,0"]) in FITTED
    printed = capsys.readouterr().out
    assert data["status"] in printed.splitlines()[0]
    assert all(warning in printed for warning in data["warnings"])
    assert any("decorrelation distance" in warning for warning in data["warnings"])


def test_other_maximum_is_in_the_json(log: Path, capsys, monkeypatch) -> None:
    """Its parameters and its likelihood, after the best one's."""
    from planopt.channel.estimation import fit as fitting
    from planopt.channel.estimation.channel_fit import OtherMode

    fit_channel = fitting.fit_channel
    monkeypatch.setattr(fitting, "fit_channel", lambda *a, **o: with_mode(fit_channel(*a, **o)))

    def with_mode(found):
        return dataclasses.replace(found, other_modes=(OtherMode(found.parameters, -7.5),))

    assert main(["fit", str(log), "--station", "0,0,0.5", *COLUMNS, "--json"]) in FITTED
    data = json.loads(capsys.readouterr().out)
    (mode,) = data["other_modes"]
    assert mode.pop("log_likelihood") == -7.5
    assert mode == {name: data[name] for name in mode} and len(mode) == 5


def test_robust_losses(log: Path, capsys) -> None:
    """--loss changes what convex makes of the scatter, and nothing of the path loss."""
    arguments = ["fit", str(log), "--station", "0,0,0.5", *COLUMNS, "--method", "convex", "--json"]
    found = []
    for option in ([], ["--loss", "squares"], ["--loss", "huber"], ["--loss", "absolute"]):
        assert main([*arguments, *option]) in FITTED
        found.append(json.loads(capsys.readouterr().out))
    assert found[0] == found[1]
    assert len({fit["n_pl"] for fit in found}) == 1
    assert len({(fit["shadow_std_db"], fit["decorrelation_m"]) for fit in found}) == 3


def test_floor_marks_the_same_rows(log: Path, capsys) -> None:
    """--floor at the floor censors what the column marks."""
    for option in (["--censored", "low"], ["--floor", "-95"]):
        arguments = ["fit", str(log), "--station", "0,0", "--method", "capped", "--json"]
        assert main([*arguments, *COLUMNS, *option]) in FITTED
    first, second = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert first == second and first["method"] == "capped"


def test_fit_prints_text(log: Path, capsys) -> None:
    """Each parameter with its error and unit, then the warnings."""
    assert main(["fit", str(log), "--station", "unknown", *COLUMNS, "--floor=-95"]) in FITTED
    text = capsys.readouterr().out
    assert text.startswith("channel fit by maximum a posteriori: ") and "decorrelation_m" in text
    assert "is estimated, not given" in text


def test_pictures_of_fits(log: Path, tmp_path: Path) -> None:
    """A picture beside the JSON, also of a single measurement, whose axes are widened."""
    out = tmp_path / "fit"
    assert main(["fit", str(log), "--station", "0,0", *COLUMNS, "--out", str(out)]) in FITTED
    assert {f.name for f in out.iterdir()} == {"fit.json", "fit.png"}
    assert (out / "fit.png").read_bytes().startswith(b"\x89PNG")
    (tmp_path / "log.csv").write_text("x_m,y_m,power_dbm\n-295,-1,-82.6\n")
    out = tmp_path / "fit"
    arguments = ["fit", str(tmp_path / "log.csv"), "--station", "7,7", "--floor", "0"]
    assert main([*arguments, "--out", str(out)]) == 3
    assert (out / "fit.png").stat().st_size > 0


BAD_LOGS = {
    "missing column": "x_m,y_m\n1,2\n",
    "empty file": "",
    "all in one place": "x_m,y_m,power_dbm\n" + "4,5,-60\n" * 9,
    "at the station": "x_m,y_m,power_dbm\n1,2,-60\n0,0,-20\n3,4,-61\n",
}


@pytest.mark.parametrize("name", BAD_LOGS)
def test_a_bad_log_is_one_line(name: str, tmp_path: Path, capsys) -> None:
    """Exit code 2, the file and what is wrong on one line of stderr, and no folder is left."""
    path, out = tmp_path / "bad.csv", tmp_path / "out"
    path.write_text(BAD_LOGS[name])
    refused_command(capsys, "fit", path, "--station", "0,0", "--json", "--out", out)
    assert not out.exists()


def test_repeated_places_are_data(tmp_path: Path, capsys) -> None:
    """The same place measured several times is no error."""
    path = tmp_path / "log.csv"
    rows = [f"{x},{y},{-60 - x - 0.1 * k}" for x in (1, 5, 9) for y in (2, 7) for k in range(3)]
    path.write_text("\n".join(["x_m,y_m,power_dbm", *rows]))
    assert main(["fit", str(path), "--station=-20,0", "--json"]) in FITTED
    assert json.loads(capsys.readouterr().out)["measurements"] == 18


@pytest.fixture
def shared_log(tmp_path: Path) -> Path:
    """Two robots, of which the second reads 6 dB more; rounded, dated, with errors of position."""
    generator = np.random.default_rng(9)
    places = generator.uniform(10.0, 200.0, (120, 2))
    power = -30.0 - 30.0 * np.log10(np.hypot(*places.T)) + generator.normal(0.0, 1.0, 120)
    rows = [
        f"{x:.3f},{y:.3f},{round(p + 6.0 * (i % 2))},{10 * i},{'ann' if i % 2 == 0 else 'bob'}"
        for i, ((x, y), p) in enumerate(zip(places, power, strict=True))
    ]
    path = tmp_path / "shared.csv"
    path.write_text("\n".join(["x_m,y_m,power_dbm,t,robot", *rows]))
    return path


EVERYTHING = ["--receiver", "robot", "--time", "t", "--forgetting", "600"]
EVERYTHING += ["--resolution", "1", "--position-error", "2.5"]


@pytest.mark.parametrize("station", ["0,0", "unknown"])
def test_receivers_ages_and_errors(shared_log: Path, station: str, capsys) -> None:
    """The second robot's offset is found, named by its label, and printed."""
    arguments = ["fit", str(shared_log), "--station", station, *EVERYTHING]
    assert main([*arguments, "--json"]) in FITTED
    data = json.loads(capsys.readouterr().out)
    assert set(data) >= CONTRACT and data["forgetting_s"] == 600.0
    assert data["reference_receiver"] == "ann"
    (offset,) = data["receiver_offsets"]
    assert offset["receiver"] == "bob"
    assert abs(offset["offset_db"] - 6.0) < 3.0 * offset["standard_error"] < 3.0
    assert main(arguments) in FITTED
    assert "receiver bob reads +" in capsys.readouterr().out


def test_without_receivers_and_forgetting(shared_log: Path, capsys) -> None:
    assert main(["fit", str(shared_log), "--station", "0,0", "--json"]) in FITTED
    data = json.loads(capsys.readouterr().out)
    assert data["forgetting_s"] is None and data["reference_receiver"] is None
    assert data["receiver_offsets"] == []


@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--station", "0"],
        ["--station", "0,a"],
        ["--station", "1e300,0"],
        ["--station", "unknown", "--station-method", "guess"],
        ["--station", "1,2", "--station-method", "line"],
        ["--station", "0,0", "--method", "magic"],
        ["--station", "0,0", "--method", "convex", "--loss", "cauchy"],
        ["--station", "0,0", "--loss", "huber"],
        ["--station", "0,0", "--columns", "x=east,z=north"],
        ["--station", "0,0", "--columns", "x=est"],
        ["--station", "0,0", "--floor", "low"],
        ["--station", "0,0", "--floor", "nan"],
        ["--station", "0,0", "--censored", "high"],
        ["--station", "0,0", "--forgetting", "60"],
        ["--station", "0,0", "--forgetting", "0", "--time", "t"],
        ["--station", "0,0", "--forgetting", "nan", "--time", "t"],
        ["--station", "0,0", "--resolution=-1"],
        ["--station", "0,0", "--position-error", "inf"],
        ["--station", "0,0", "--time", "robot"],
        ["--station", "0,0", "--receiver", "name"],
    ],
)
def test_options_that_cannot_be_used(shared_log: Path, options, capsys) -> None:
    """One line that names the option, or the log's line and column; exit code 2."""
    refused_command(capsys, "fit", shared_log, *options)


def written(path: Path, places: np.ndarray, power: np.ndarray) -> Path:
    rows = [f"{x},{y},{p}" for (x, y), p in zip(places, power, strict=True)]
    path.write_text("\n".join(["x_m,y_m,power_dbm", *rows]))
    return path


@pytest.fixture
def round_log(tmp_path: Path) -> Path:
    """Eighty noisy powers along a path loss of exponent 3, station at (120, 60)."""
    generator = np.random.default_rng(8)
    places = generator.uniform(0.0, 200.0, (80, 2))
    distance = np.hypot(*(places - (120.0, 60.0)).T)
    power = -30.0 - 30.0 * np.log10(distance) + generator.normal(0.0, 2.0, 80)
    return written(tmp_path / "log.csv", places, power)


def fitted(log: Path, capsys, *options: str) -> dict:
    assert main(["fit", str(log), "--json", *options]) in FITTED
    return json.loads(capsys.readouterr().out)


def test_standard_errors_of_the_station(round_log: Path, capsys) -> None:
    """Two numbers if it is estimated, by either method, in JSON and in words; else null."""
    joint = fitted(round_log, capsys, "--station", "unknown")
    line = fitted(round_log, capsys, "--station", "unknown", "--station-method", "line")
    given = fitted(round_log, capsys, "--station", "120,60")
    assert fitted(round_log, capsys, "--station", "unknown", "--station-method", "joint") == joint
    assert line["station"] != joint["station"]
    assert given["station_standard_errors_m"] is None
    for one in (joint, line):
        errors = one["station_standard_errors_m"]
        assert all(0.0 < error < 10.0 for error in errors)
        assert np.all(np.abs(np.subtract(one["station"], (120.0, 60.0))) < 4.0 * np.array(errors))
    assert main(["fit", str(round_log), "--station", "unknown"]) in FITTED
    third = capsys.readouterr().out.splitlines()[2]
    assert re.search(r"station at \([\d.]+, [\d.]+\) \+- \([\d.]+, [\d.]+\) m$", third)
    assert main(["fit", str(round_log), "--station", "120,60"]) in FITTED
    assert "station at (120, 60) m\n" in capsys.readouterr().out


def test_station_not_bounded_is_null(tmp_path: Path, capsys) -> None:
    """Powers that rise steadily to one side: errors are null, and the status says so."""
    generator = np.random.default_rng(3)
    places = generator.uniform(0.0, 100.0, (60, 2))
    power = -80.0 + 0.05 * places[:, 0] + np.random.default_rng(4).normal(0.0, 2.0, 60)
    log = written(tmp_path / "log.csv", places, power)
    found = fitted(log, capsys, "--station", "unknown", "--station-method", "line")
    assert found["status"] == "degenerate"
    assert found["station_standard_errors_m"] == [None, None]
    assert found["standard_errors"]["n_pl"] is None
