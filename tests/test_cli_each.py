"""``--each``: the channel of every transmitter of a log, and the map of the best of them."""

import json
from pathlib import Path

import numpy as np
import pytest
from refusals import refused_command

from planopt.cli import main

SITES = {"a:1": (0.0, 0.0), "b:2": (80.0, 50.0)}
FITTED = (0, 3)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sixty readings of each of two transmitters, and two of a third; a table of positions."""
    folder = tmp_path_factory.mktemp("each")
    generator = np.random.default_rng(4)
    rows = ["x,y,rssi,bssid"]
    for name, site in SITES.items():
        places = generator.uniform(5.0, 75.0, (60, 2))
        power = -30.0 - 25.0 * np.log10(np.hypot(*(places - site).T)) + generator.normal(0, 1, 60)
        rows += [f"{x:.2f},{y:.2f},{p:.2f},{name}" for (x, y), p in zip(places, power, strict=True)]
    rows += ["1,1,-70,c:3", "2,2,-71,c:3"]
    (folder / "log.csv").write_text("\n".join(rows))
    table = [f"{name},{x},{y}" for name, (x, y) in SITES.items()]
    (folder / "stations.csv").write_text("\n".join(["bssid,x_m,y_m", *table, "d:4,1,1"]))
    return folder / "log.csv"


def found(capsys, *arguments: object) -> dict:
    assert main([*map(str, arguments), "--json"]) in FITTED
    return json.loads(capsys.readouterr().out)


def test_every_fit_is_that_of_its_rows(log: Path, tmp_path: Path, capsys) -> None:
    """As with --where and --station one by one; transmitters with few readings are named."""
    stations = log.parent / "stations.csv"
    each = found(
        *(capsys, "fit", log, "--each", "bssid", "--stations", stations, "--out", tmp_path)
    )
    assert each["left_out"] == {"c:3": 2} and list(each["fits"]) == list(SITES)
    for name, (x, y) in SITES.items():
        alone = found(capsys, "fit", log, "--where", f"bssid={name}", "--station", f"{x},{y}")
        assert each["fits"][name] == alone
    files = {path.name for path in tmp_path.iterdir()}
    assert files == {"fit.json", "fit_1_a-1.png", "fit_2_b-2.png"}


def test_transmitters_are_located(log: Path, capsys) -> None:
    """Each where it is; a fit of several transmitters as one has a warning."""
    each = found(capsys, "fit", log, "--each", "bssid", "--station", "unknown")
    for name, site in SITES.items():
        assert np.hypot(*np.subtract(each["fits"][name]["station"], site)) < 5.0
    together = found(capsys, "fit", log, "--station", "0,0")
    alone = found(capsys, "fit", log, "--station", "0,0", "--where", "bssid=a:1")
    assert "bssid names 3 transmitters" in together["warnings"][0]
    assert not any("transmitters" in each for each in alone["warnings"])


def test_the_best_server(log: Path, tmp_path: Path, capsys) -> None:
    """P(any) is that of independent transmitters, the power that of the stronger one."""
    stations, grid = log.parent / "stations.csv", ["--bounds", "0,0,80,50", "--cell", "5"]
    grid += ["--threshold", "-68"]
    picture = tmp_path / "best.png"
    both = found(
        *(capsys, "map", log, "--each", "bssid", "--stations", stations, *grid),
        *("--out", tmp_path / "best.npz", "--picture", picture),
    )
    assert [each["station"] for each in both["fits"]] == list(SITES) and picture.is_file()
    with np.load(tmp_path / "best.npz") as best:
        power, chance = best["mean_db"], best["connectivity"]
    alone = []
    for name, (x, y) in SITES.items():
        out = tmp_path / "own.npz"
        own = ["--where", f"bssid={name}", "--station", f"{x},{y}", "--out", out]
        found(capsys, "map", log, *own, *grid)
        with np.load(out) as map_of_one:
            alone.append((map_of_one["mean_db"], map_of_one["connectivity"]))
    np.testing.assert_array_equal(power, np.maximum(alone[0][0], alone[1][0]))
    np.testing.assert_allclose(chance, 1.0 - (1.0 - alone[0][1]) * (1.0 - alone[1][1]), atol=1e-9)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--each", "bssid"],
        ["--each", "absent", "--station", "unknown"],
        ["--each", "rssi", "--station", "unknown"],
        ["--each", "bssid", "--station", "unknown", "--hold-out", "bssid"],
        ["--stations", "stations.csv", "--station", "0,0"],
        ["--each", "bssid", "--stations", "absent.csv"],
    ],
)
def test_refusals(arguments: list[str], log: Path, capsys) -> None:
    refused_command(capsys, "fit", log, *arguments)
