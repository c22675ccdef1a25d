"""``planopt fit --hold-out``: what is printed, drawn and refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refused_command

from planopt.channel import ChannelParameters, Station
from planopt.channel.measurements import shadow_covariance_db2
from planopt.cli import main

PREDICTORS = ["channel", "marginal", "path_loss", "plain_line", "plain_process"]
CHANNEL = ChannelParameters(-30.0, 3.0, 6.0, 60.0, 1.5, Station((0.0, 0.0)))


def power_dbm(places: NDArray[np.float64], generator: np.random.Generator) -> NDArray[np.float64]:
    covariance = shadow_covariance_db2(places, places, CHANNEL) + 2.25 * np.eye(len(places))
    path_loss = -30.0 - 30.0 * np.log10(np.hypot(*places.T))
    return path_loss + np.linalg.cholesky(covariance) @ generator.standard_normal(len(places))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Two days of 75 powers each, one every 10 s, the weakest cut at -100 dBm."""
    generator = np.random.default_rng(2)
    places = generator.uniform(10.0, 200.0, (150, 2))
    rows = [
        f"{x:.3f},{y:.3f},{max(power, -100.0):.3f},{'tue' if i >= 75 else 'mon'},{10 * (i % 75)}"
        for i, ((x, y), power) in enumerate(zip(places, power_dbm(places, generator), strict=True))
    ]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["x_m,y_m,power_dbm,day,t_s", *rows]))
    return path


def run(log: Path, *options: str) -> int:
    return main(["fit", str(log), "--station", "0,0", "--floor", "-100", *options])


def test_json(log: Path, capsys) -> None:
    """Groups, folds, and for all RMSE and coverage with intervals; no other key changes."""
    assert run(log, "--json") == 0
    plain = json.loads(capsys.readouterr().out)
    assert run(log, "--hold-out", "day,t_s:250", "--json") == 0
    data = json.loads(capsys.readouterr().out)
    held_out = data.pop("held_out")
    assert data == plain
    assert (held_out["groups"], held_out["folds"]) == (6, 6)
    assert sum(held_out["fold_sizes"]) == held_out["measurements"] == 150
    assert held_out["censored"] == data["censored"] > 0
    assert list(held_out["predictors"]) == PREDICTORS
    for score in held_out["predictors"].values():
        assert score["rmse_db"]["low"] < score["rmse_db"]["value"] < score["rmse_db"]["high"]
        levels = [one["level"] for one in score["coverage"]]
        assert {0.5, 0.8, 0.95} <= set(levels)
        assert all(one["low"] <= one["value"] <= one["high"] for one in score["coverage"])
    channel = held_out["predictors"]["channel"]
    assert channel["of_path_loss"]["value"] < 0.9
    assert held_out["predictors"]["path_loss"]["of_path_loss"]["value"] == 1.0


def test_reliability(log: Path, capsys) -> None:
    """Every power that tells is in one bin; limits above the threshold are left out."""
    columns = ["--hold-out", "day,t_s:250", "--json"]
    for threshold, known in ((None, 150), (-90.0, 150), (-110.0, None)):
        asked = [] if threshold is None else [f"--threshold={threshold}"]
        assert run(log, *columns, *asked) == 0
        held_out = json.loads(capsys.readouterr().out)["held_out"]
        exact = held_out["measurements"] - held_out["censored"]
        for score in held_out["predictors"].values():
            bins = score["reliability"]
            assert sum(one["count"] for one in bins) == (exact if known is None else known)
            assert all(one["groups"] <= 6 for one in bins)
            for one in bins:
                if one["groups"] >= 5:
                    assert one["ci_low"] <= one["connected_share"] <= one["ci_high"]
        if threshold is None:
            connected = sum(one["count"] * one["connected_share"] for one in bins)
            assert connected == pytest.approx(75, abs=1)
        else:
            assert held_out["threshold_dbm"] == threshold


def test_many_groups_are_dealt_into_few_folds(log: Path, monkeypatch, capsys) -> None:
    """Shares of them are held out at once, whole groups together."""
    monkeypatch.setattr("planopt.commands.fit.MOST_FOLDS", 2)
    assert run(log, "--hold-out", "day,t_s:100", "--json") == 0
    held_out = json.loads(capsys.readouterr().out)["held_out"]
    assert (held_out["groups"], held_out["folds"]) == (16, 2)
    assert sum(held_out["fold_sizes"]) == 150


def test_words_and_picture(log: Path, tmp_path: Path, capsys) -> None:
    """A table for people; with --out the calibration is drawn."""
    out = tmp_path / "fit"
    assert run(log, "--hold-out", "day", "--out", str(out)) == 0
    text = capsys.readouterr().out
    assert (
        "cross-validation by day: 2 groups in 2 folds, no intervals for fewer than 5 groups" in text
    )
    scores = text.split("cross-validation by")[1].split("P(power")[0]
    assert "channel" in scores and " to " not in scores
    for word in (*PREDICTORS, "in 95 % interval"):
        assert word in text
    assert "P(power >= -9" in text and "no intervals for fewer than 5 groups" in text
    pictures = {"fit.png", "held_out.png", "reliability.png"}
    assert {file.name for file in out.iterdir()} == {"fit.json", *pictures}
    assert "held_out" in json.loads((out / "fit.json").read_text())


@pytest.mark.parametrize(
    "options",
    [
        ["--hold-out", "week"],
        ["--hold-out", "day:2"],
        ["--hold-out", "day", "--floor", "0"],
        ["--hold-out", "t_s:0"],
        ["--hold-out", "t_s:1e6"],
        ["--hold-out", "day", "--receiver", "day"],
        ["--threshold=-90"],
        ["--hold-out", "day", "--threshold=nan"],
    ],
)
def test_refused(log: Path, tmp_path: Path, options: list[str], capsys) -> None:
    out = tmp_path / "out"
    refused_command(capsys, "fit", log, "--station", "0,0", *options, "--out", out)
    assert not out.exists()


def test_too_little_is_left(tmp_path: Path, capsys) -> None:
    """Where a fold leaves nothing that can be fitted, the error says so and names no wrong line."""
    path = tmp_path / "log.csv"
    path.write_text("x_m,y_m,power_dbm,day\n1,0,-40,0\n2,0,-50,0\n3,0,-55,1\n3,0,-56,1\n")
    refused_command(capsys, "fit", path, "--station", "0,0", "--hold-out", "day")


def test_numbers_are_there_before_pictures(log: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    """Where drawing fails, the file and the text have been written."""

    def fail(*_: object) -> None:
        raise OSError("no ink")

    monkeypatch.setattr("planopt.report.panel.save_figure", fail)
    out = tmp_path / "fit"
    assert run(log, "--hold-out", "day", "--out", str(out)) == 2
    printed = capsys.readouterr()
    assert "cross-validation by day" in printed.out and "cannot be written: no ink" in printed.err
    assert {file.name for file in out.iterdir()} == {"fit.json"}
