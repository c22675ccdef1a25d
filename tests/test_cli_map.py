"""``planopt map``: files, options and errors."""

import json
from pathlib import Path

import numpy as np
import pytest
from refusals import refused_command

import planopt
from planopt.channel import Station, condition, fit_channel, read_log
from planopt.cli import main
from planopt.problems.library import library_folder
from planopt.world import read_raster
from planopt.world.nav2_masks import NAV2_FILES

CONTRACT = {"mean_db", "deviation_db", "connectivity"}


FITTED = (0, 3)
"""Exit codes of a fit; 3 if the log does not determine the channel."""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Fifty noisy powers along a path loss of exponent 3, station at (0, 0)."""
    generator = np.random.default_rng(8)
    places = generator.uniform(10.0, 210.0, (50, 2))
    power = -30.0 - 30.0 * np.log10(np.hypot(*places.T)) + generator.normal(0.0, 2.0, 50)
    rows = [f"{x:.3f},{y:.3f},{p:.3f}" for (x, y), p in zip(places, power, strict=True)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["x_m,y_m,power_dbm", *rows]))
    return path


@pytest.mark.parametrize("ending", ["csv", "npz", "nc", "tif"])
def test_map_is_the_posterior(log: Path, ending: str, capsys) -> None:
    """The file's variables are those of the Python calls; the JSON says what was written."""
    if ending == "tif":
        pytest.importorskip("rasterio")
    out = log.parent / "new" / f"map.{ending}"
    arguments = ["map", str(log), "--station", "0,0,2", "--out", str(out), "--cell", "20"]
    options = ["--bounds=20,0,100,60", "--threshold", "-90", "--method", "capped", "--json"]
    assert main([*arguments, *options]) in FITTED
    printed = capsys.readouterr()
    data = json.loads(printed.out)
    assert printed.err == "" and set(data["variables"]) == CONTRACT
    assert data["file"] == str(out) and data["picture"] is None
    assert (data["shape"], data["cell_m"], data["threshold_dbm"]) == ([3, 4], 20.0, -90.0)
    assert (data["x_m"], data["y_m"]) == ([30.0, 90.0], [10.0, 50.0])
    assert data["posterior"] == "exact" and data["fit"]["method"] == "capped"
    measurements = read_log(log)
    fit = fit_channel(measurements, Station((0.0, 0.0), 2.0), "capped")
    posterior = condition(fit.parameters, measurements)
    place = np.array([[70.0, 50.0]])
    prediction = posterior.predict(place)
    for name, value in (
        ("mean_db", prediction.mean_db[0]),
        ("deviation_db", prediction.deviation_db[0]),
        ("connectivity", posterior.connectivity(place, -90.0)[0]),
    ):
        assert read_raster(out, name).values[2, 2] == pytest.approx(value, rel=1e-9)


def test_defaults_and_picture(log: Path, capsys) -> None:
    """About 200 cells over what was measured, the weakest power as threshold, and a picture."""
    out, picture = log.parent / "map.npz", log.parent / "pictures" / "map.png"
    arguments = ["map", str(log), "--station", "unknown", "--out", str(out)]
    assert main([*arguments, "--picture", str(picture), "--method", "lemma1"]) in FITTED
    text = capsys.readouterr().out
    measurements = read_log(log)
    raster = read_raster(out, "connectivity")
    assert 190 <= max(raster.values.shape) <= 211
    assert abs(raster.x_m[0] - measurements.positions_m[:, 0].min()) < raster.cell_m[0]
    assert f"P(power at least {measurements.power_dbm.min():g} dBm)" in text
    assert "is estimated, not given" in text and str(picture) in text
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_floor_is_the_threshold(log: Path, capsys) -> None:
    """Where a floor is given, connected means above it."""
    out = log.parent / "map.npz"
    arguments = ["map", str(log), "--station", "0,0", "--out", str(out), "--cell", "50"]
    assert main([*arguments, "--floor=-95", "--json", "--method", "capped"]) in FITTED
    data = json.loads(capsys.readouterr().out)
    assert data["threshold_dbm"] == -95.0 and data["fit"]["censored"] > 0


@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--out", "map.asc"],
        ["--out", "new/map.npz", "--cell", "0"],
        ["--out", "new/map.npz", "--bounds", "0,0,1"],
        ["--out", "new/map.npz", "--bounds", "0,0,1,b"],
        ["--out", "new/map.npz", "--bounds", "5,0,1,1"],
        ["--out", "new/map.npz", "--picture", "new/map.gif"],
        ["--out", "log.csv/map.npz"],
    ],
)
def test_a_bad_option_is_one_line(
    log: Path, options: list[str], capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 2, one line on stderr, and nothing is left behind."""
    monkeypatch.chdir(log.parent)
    refused_command(capsys, "map", "log.csv", "--station", "0,0", *options)
    assert [path.name for path in log.parent.iterdir()] == ["log.csv"]


def test_unknown_station_and_loss(log: Path, capsys) -> None:
    """The fit that is mapped is that of `planopt fit` with the same options."""
    options = ["--station", "unknown", "--station-method", "line", "--method", "convex"]
    options += ["--loss", "huber", "--json"]
    assert main(["fit", str(log), *options]) in FITTED
    fitted = json.loads(capsys.readouterr().out)
    out = log.parent / "map.npz"
    assert main(["map", str(log), *options, "--cell", "20", "--out", str(out)]) in FITTED
    assert json.loads(capsys.readouterr().out)["fit"] == fitted


def test_map_of_the_reference_receiver(log: Path, capsys) -> None:
    """What a second receiver adds to its powers is not in the map."""
    rows = log.read_text().splitlines()
    labelled = [f"{rows[0]},who"] + [
        f"{row[: row.rindex(',')]},{float(row.split(',')[2]) + 9.0 * (i % 2)},{'ab'[i % 2]}"
        for i, row in enumerate(rows[1:])
    ]
    log.write_text("\n".join(labelled))
    out = log.parent / "map.npz"
    means = []
    for options in (["--receiver", "who"], []):
        arguments = ["map", str(log), "--station", "0,0", "--out", str(out), "--cell", "20"]
        assert main([*arguments, "--json", *options]) in FITTED
        means.append(read_raster(out, "mean_db").values.mean())
    fits = [json.loads(line)["fit"] for line in capsys.readouterr().out.splitlines()]
    assert fits[0]["receiver_offsets"][0]["offset_db"] == pytest.approx(9.0, abs=2.0)
    assert means[1] - means[0] == pytest.approx(4.5, abs=1.0)


def test_masks(log, tmp_path, capsys):
    """Masks without a map file have its shares; those of a problem are of the best station."""
    masks = tmp_path / "masks"
    arguments = ["map", str(log), "--station", "0,0", "--threshold", "-70", "--cell", "2"]
    assert main([*arguments, "--nav2", str(masks), "--p-min", "0.6", "--json"]) in FITTED
    data = json.loads(capsys.readouterr().out)
    assert data["file"] is None and data["nav2"]["p_min"] == 0.6
    assert main([*arguments, "--out", str(tmp_path / "m.npz"), "--json"]) in FITTED
    capsys.readouterr()
    with np.load(tmp_path / "m.npz") as saved:
        chance = saved["connectivity"]
    assert data["nav2"]["keepout_share"] == np.mean(chance < 0.1)
    assert data["nav2"]["contact_share"] == np.mean(chance >= 0.6)
    assert {path.name for path in masks.iterdir()} == set(NAV2_FILES)
    file = str(library_folder() / "two_station_courier.toml")
    found = []
    for named in (file, "two_station_courier"):
        assert main(["map", named, "--nav2", str(tmp_path), "--cell", "20", "--json"]) == 0
        found.append(json.loads(capsys.readouterr().out))
    data, by_name = found
    assert by_name == data
    problem = planopt.load(file)
    assert len(data["fits"]) == 2 and data["nav2"]["p_min"] == problem.constraints.p_min
    x_min, _, x_max, _ = problem.workspace.bounds_m
    assert data["x_m"][0] == x_min + 10.0 and x_max - 20.0 < data["x_m"][1] < x_max + 20.0
    assert main(["map", file, "--nav2", str(tmp_path), "--station", "0,0"]) == 2
    assert "--station is for logs" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ([], "give --out FILE or --nav2 DIR"),
        (["--nav2", "masks", "--p-min", "90"], "p_min is 90.0 (give a probability, 0 to 1)"),
        (["--nav2", "masks", "--keepout-below", "-1"], "keepout_below"),
    ],
)
def test_masks_that_are_none(more, words, log, tmp_path, capsys, monkeypatch):
    """The option is named, and nothing is left behind."""
    monkeypatch.chdir(tmp_path)
    assert main(["map", str(log), "--station", "0,0", *more]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "masks").exists()
