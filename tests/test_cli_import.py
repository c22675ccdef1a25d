"""``planopt import``: from a map and a log to a problem file that can be solved as it is."""

import itertools
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from refusals import expect_message

import planopt
from planopt.channel import scattered_field_db
from planopt.cli import main
from planopt.world.geodesy import longitude_latitude_deg

ORIGIN = (48.1374, 11.5755)
SITES = {"aa:01": (5.0, 30.0), "aa:02": (75.0, 22.0)}
START, GOAL = "-12,-4", "50,43"
RESOLUTION = 0.5


def yard_image() -> np.ndarray:
    """A yard of 80 m by 60 m with two buildings, and unknown space beyond a fence in the east."""
    image = np.full((120, 160), 254, dtype=np.uint8)
    image[40:80, 50:70] = 0
    image[20:60, 105:115] = 0
    image[:, 150:] = 205
    return image


def readings() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """A drive around the buildings in the map's frame, and the rounded powers of both masts."""
    generator = np.random.default_rng(5)
    along = np.linspace(0.0, 1.0, 30)[:, None]
    corners = np.array([(5, 5), (72, 5), (72, 55), (45, 55), (45, 12), (20, 12), (20, 55), (5, 55)])
    parts = [a + along * (b - a) for a, b in itertools.pairwise(corners)]
    drive = np.vstack([*parts, [[5.0, 50.0], [8.0, 20.0]]])
    powers = {}
    for name, site in SITES.items():
        distance = np.maximum(np.hypot(*(drive - site).T), 1.0)
        power = -32.0 - 26.0 * np.log10(distance) + generator.normal(0, 1.0, len(drive))
        power += scattered_field_db(
            drive, shadow_std_db=2.0, decorrelation_m=6.0, generator=generator
        )
        powers[name] = np.maximum(np.round(power), -84.0)
    # The map's origin is its pixel (40, 20)
    return drive - (20.0, 10.0), powers


@pytest.fixture(scope="module")
def yard(tmp_path_factory) -> Path:
    """Map, a log in degrees, the same log in metres with semicolons, and that of one mast."""
    folder = tmp_path_factory.mktemp("yard")
    Image.fromarray(yard_image()).save(folder / "yard.pgm")
    (folder / "yard.yaml").write_text(
        f"image: yard.pgm\nresolution: {RESOLUTION}\norigin: [-20.0, -10.0, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    places, powers = readings()
    degrees = longitude_latitude_deg(places, ORIGIN)
    lines, metres = ["stamp,lat,lon,rssi,BSSID"], ["Zeit;x;y;RSSI"]
    for row, ((longitude, latitude), (x, y)) in enumerate(zip(degrees, places, strict=True)):
        for name, power in powers.items():
            stamp = f"2026-03-14T09:{row // 60:02}:{row % 60:02}"
            lines.append(f"{stamp},{latitude:.7f},{longitude:.7f},{power[row]:.0f},{name}")
        metres.append(f"{row};{x:.2f};{y:.2f};{powers['aa:01'][row]:.1f}".replace(".", ","))
    lines += ["2026-03-14T10:00:00,48.1374,11.5755,-80,bb:03"] * 3
    (folder / "log.csv").write_text("\n".join(lines))
    (folder / "metres.csv").write_text("\n".join(metres))
    return folder


def imported(capsys, *arguments: object, code: int = 0) -> dict:
    assert main(["import", *map(str, arguments), "--json"]) == code
    return json.loads(capsys.readouterr().out)


@pytest.fixture(scope="module")
def made(yard: Path) -> Path:
    out = yard / "mine.toml"
    code = main(
        ["import", "--map", str(yard / "yard.yaml"), "--log", str(yard / "log.csv")]
        + ["--origin", "48.1374,11.5755", "--transmitter-column", "BSSID"]
        + ["--start", START, "--goal", GOAL, "--out", str(out), "--json"]
    )
    assert code == 0
    return out


def test_a_map_and_a_log_become_a_plan(made: Path, capsys) -> None:
    """Three commands, no editing: the plan is verified and checked."""
    assert main(["solve", str(made), "--out", str(made.parent / "plan"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "verified"
    assert main(["check", str(made.parent / "plan")]) == 0


def test_what_the_problem_says(made: Path, yard: Path) -> None:
    """Both masts near where they are, one log without repetition, unknown space an obstacle."""
    problem = planopt.load(made)
    assert [station.name for station in problem.stations] == ["aa-01", "aa-02"]
    for station, site in zip(problem.stations, SITES.values(), strict=True):
        away = np.array(station.position_m) - (np.array(site) - (20.0, 10.0))
        assert np.hypot(*away) < 8.0
    assert problem.workspace.bounds_m == (-20.0, -10.0, 60.0, 50.0)
    area = sum(each.polygon.area for each in problem.workspace.obstacles)
    assert area == pytest.approx((yard_image() != 254).sum() * RESOLUTION**2)
    keys = tomllib.loads(made.read_text())["channel"]["measurements"]
    assert (keys["file"], keys["transmitter_column"]) == ("log.csv", "BSSID")
    assert keys["columns"] == {"x": "lon", "y": "lat", "power": "rssi"}
    assert (keys["resolution_db"], keys["origin_deg"]) == (1.0, [48.1374, 11.5755])
    solution = planopt.solve(problem, horizon=2)
    for posterior, power in zip(solution.belief.posteriors, readings()[1].values(), strict=True):
        places, _ = readings()
        np.testing.assert_allclose(posterior.measurements.positions_m, places, atol=0.01)
        np.testing.assert_array_equal(posterior.measurements.power_dbm, power)
    assert (yard / "mine.png").stat().st_size > 10_000


def test_a_log_suffices_for_a_simulation(made: Path, capsys) -> None:
    """The channel is drawn from the fit to the log."""
    assert main(["simulate", str(made), "--horizon", "3", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["outcome"] == "reached"


def test_what_is_printed(yard: Path, tmp_path: Path, capsys) -> None:
    """Every assumption is a sentence, in the output and in the file."""
    data = imported(
        *(capsys, "--map", yard / "yard.yaml", "--log", yard / "log.csv"),
        *("--origin", "48.1374,11.5755", "--start", START, "--goal", GOAL),
        *("--out", tmp_path / "mine.toml", "--threshold", "-75", "--speed", "2"),
    )
    said = " ".join(data["assumptions"])
    for words in (
        "columns lon, lat (degrees) and rssi, separated by commas",
        "column BSSID names the transmitter",
        "1 of 3 transmitters are left out",
        "powers are rounded to 1 dB",
        "unknown cells (6 % of the map) are occupied",
        "aa:01 is at",
        "(95 %); plans use this position as if it were exact",
        "clearance",
    ):
        assert words in said, said
    assert "--threshold" not in said and "--speed" not in said
    assert not any("map" in warning for warning in data["warnings"])
    text = (tmp_path / "mine.toml").read_text()
    assert all(f"# - {each}" in text for each in data["assumptions"])
    assert [each["transmitter"] for each in data["stations"]] == list(SITES)


def test_a_log_in_metres_without_a_map(yard: Path, tmp_path: Path, capsys) -> None:
    """Semicolons, decimal commas, German names; the station is given; the world is the log's."""
    data = imported(
        *(capsys, "--log", yard / "metres.csv", "--station", "-15,20,3"),
        *("--start", START, "--goal", "50,40", "--out", tmp_path / "mine.toml"),
        *("--threshold", "75"),
    )
    assert "75 dBm is implausible" in data["warnings"][-1]
    (station,) = data["stations"]
    assert station["position_m"] == [-15.0, 20.0] and not station["located"]
    problem = planopt.load(tmp_path / "mine.toml")
    assert problem.stations[0].height_m == 3.0 and not problem.workspace.obstacles
    solution = planopt.solve(problem, horizon=3)
    places, powers = readings()
    measured = solution.belief.posterior.measurements
    np.testing.assert_allclose(measured.positions_m, places, atol=0.006)
    np.testing.assert_array_equal(measured.power_dbm, powers["aa:01"])


@pytest.mark.parametrize(
    ("sign", "words"), [(1, "mix several transmitters"), (-1, "write the minus sign")]
)
def test_logs_that_do_not_fit_one_transmitter(
    sign: int, words: str, yard: Path, tmp_path: Path, capsys
) -> None:
    """Two transmitters without names, or powers without a sign: a hint, and no inf or dash."""
    places, powers = readings()
    rows = [
        f"{x:.2f},{y:.2f},{sign * power[row]:.0f}"
        for row, (x, y) in enumerate(places)
        for power in powers.values()
    ]
    log = tmp_path / "log.csv"
    log.write_text("\n".join(["x,y,rssi", *rows]))
    out = tmp_path / "mine.toml"
    arguments = ["import", "--log", log, "--start", START, "--goal", GOAL, "--out", out]
    code = 3 if sign < 0 else 0
    for command in (arguments, ["fit", log, "--station", "unknown"]):
        assert main([*map(str, command)]) == code
        said = capsys.readouterr().out
        assert words in said and ("not determined" in said) == (code == 3)
        assert " inf" not in said and "+- -" not in said and "(-," not in said
    # The file marks a position that the log does not determine, and later commands warn of it.
    text = out.read_text()
    assert ("position_known = false" in text) == ("# placeholder" in text) == (code == 3)
    assert ("# located within" in text) == (code == 0)
    assert main(["validate", str(out)]) == 0
    assert ("position_m of station is a placeholder" in capsys.readouterr().out) == (code == 3)


def test_a_map_in_centimetres(yard: Path, tmp_path: Path, capsys) -> None:
    """Cells of 50 m: the size of the cells, of the log and of the steps are implausible."""
    Image.fromarray(yard_image()).save(tmp_path / "yard.pgm")
    text = (yard / "yard.yaml").read_text()
    (tmp_path / "yard.yaml").write_text(text.replace(f"resolution: {RESOLUTION}", "resolution: 50"))
    data = imported(
        *(capsys, "--map", tmp_path / "yard.yaml", "--log", yard / "metres.csv"),
        *("--start", "500,500", "--goal", "500,5000", "--out", tmp_path / "mine.toml"),
    )
    said = " ".join(data["warnings"])
    for words in ("cells of 50 m", "m of a map of 10,000 m", "may drive 200 m in a step"):
        assert words in said, said


def test_start_and_goal_in_degrees(yard: Path, tmp_path: Path, capsys) -> None:
    """The same problem as in metres; a suffix says which where both are possible."""
    places = np.array([[-12.0, -4.0], [50.0, 43.0]])
    texts = [f"{lat:.8f},{lon:.8f}" for lon, lat in longitude_latitude_deg(places, ORIGIN)]
    for suffix in ("", "deg"):
        data = imported(
            *(capsys, "--map", yard / "yard.yaml", "--log", yard / "log.csv", "--force"),
            *("--origin", "48.1374,11.5755", "--out", tmp_path / "mine.toml"),
            *("--start", texts[0] + suffix, "--goal", texts[1] + suffix),
        )
        robot = planopt.load(tmp_path / "mine.toml").robots[0]
        np.testing.assert_allclose([robot.start_m, robot.goal_m], places, atol=0.01)
        assert ("is in degrees" in " ".join(data["assumptions"])) == (suffix == "")


def refused(capsys, yard: Path, *arguments: object, **replaced: object) -> dict:
    """The error of the command with other arguments; nothing is written."""
    out = yard / "refused.toml"
    usual = {
        "--map": yard / "yard.yaml",
        "--log": yard / "log.csv",
        "--origin": "48.1374,11.5755",
        "--start": START,
        "--goal": GOAL,
        "--out": out,
    } | {f"--{key}": value for key, value in replaced.items()}
    words = [str(word) for pair in usual.items() if pair[1] is not None for word in pair]
    error = imported(capsys, *words, *arguments, code=2)
    assert not out.exists() and not out.with_suffix(".png").exists()
    return error


@pytest.mark.parametrize(
    ("replaced", "more"),
    [
        ({"origin": None}, ()),
        ({"start": "10,20"}, ()),
        ({"goal": "57,43"}, ()),
        ({"goal": "500,43"}, ()),
        ({"start": "here"}, ()),
        ({"log": "absent.csv"}, ()),
        ({"map": "absent.yaml"}, ()),
        ({}, ("--transmitter-column", "AP")),
        ({}, ("--transmitter", "cc:01")),
        ({}, ("--transmitter-column", "stamp")),
        ({}, ("--station", "5,5")),
        ({}, ("--station", "cc=5,5")),
        ({}, ("--transmitter", "bb:03")),
        ({}, ("--columns", "power=dBm")),
        ({}, ("--speed", "0")),
        ({}, ("--p-min", "2")),
        ({}, ("--power-unit", "watt")),
        ({}, ("--reader", "nobody")),
        ({"out": "mine.txt"}, ()),
        ({"goal": "48.1574,11.5755"}, ()),
    ],
)
def test_what_is_missing_is_said(replaced, more, yard: Path, capsys) -> None:
    expect_message(refused(capsys, yard, *more, **replaced)["error"])


def test_an_existing_file_is_kept(made: Path, yard: Path, capsys) -> None:
    before = made.read_bytes()
    assert (
        "--force"
        in imported(
            *(
                capsys,
                "--log",
                yard / "metres.csv",
                "--start",
                START,
                "--goal",
                GOAL,
                "--out",
                made,
            ),
            code=2,
        )["error"]
    )
    assert made.read_bytes() == before


def test_log_outside_the_map(yard: Path, tmp_path: Path, capsys) -> None:
    """A wrong origin is noticed: readings outside the map or on walls."""
    data = imported(
        *(capsys, "--map", yard / "yard.yaml", "--log", yard / "log.csv"),
        *("--origin", "48.1372,11.5755", "--start", START, "--goal", GOAL),
        *("--out", tmp_path / "mine.toml"),
    )
    said = " ".join(data["warnings"])
    assert "outside the map" in said and "occupied or unknown cells" in said


def test_a_transmitter_outside_the_map(yard: Path, tmp_path: Path, capsys) -> None:
    """Located from readings on one side of it: both facts are warnings."""
    places, _ = readings()
    power = -32.0 - 26.0 * np.log10(np.hypot(*(places - (-35.0, 20.0)).T))
    power += np.random.default_rng(7).normal(0.0, 1.0, len(places))
    table = np.column_stack([places, power])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="x,y,rssi", comments="")
    data = imported(
        *(capsys, "--map", yard / "yard.yaml", "--log", tmp_path / "log.csv"),
        *("--start", START, "--goal", GOAL, "--out", tmp_path / "mine.toml"),
        code=3,  # The log has no shadowing
    )
    said = " ".join(data["warnings"])
    assert "outside the extent of the measurements" in said and "95 % region" in said
    assert "station is located outside the map" in said


def test_a_map_that_is_turned_twice(yard: Path, tmp_path: Path, capsys) -> None:
    """By its yaw in the frame, and the frame from east: the log lies in the free space."""
    yaw, corner, origin = 0.4, np.array([-20.0, -10.0]), (*ORIGIN, 25.0)
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    places, powers = readings()
    placed = corner + (places - corner) @ turn
    lines = ["lat,lon,rssi"]
    for (longitude, latitude), power in zip(
        longitude_latitude_deg(placed, origin), powers["aa:01"], strict=True
    ):
        lines.append(f"{latitude:.7f},{longitude:.7f},{power:.0f}")
    (tmp_path / "log.csv").write_text("\n".join(lines))
    Image.fromarray(yard_image()).save(tmp_path / "yard.pgm")
    text = (yard / "yard.yaml").read_text().replace("-10.0, 0.0]", f"-10.0, {yaw}]")
    (tmp_path / "yard.yaml").write_text(text)
    ends = corner + (np.array([[-12.0, -4.0], [50.0, 43.0]]) - corner) @ turn
    data = imported(
        *(capsys, "--map", tmp_path / "yard.yaml", "--log", tmp_path / "log.csv"),
        *("--origin", "48.1374,11.5755,25", "--out", tmp_path / "mine.toml"),
        *(f"--start={ends[0][0]},{ends[0][1]}", f"--goal={ends[1][0]},{ends[1][1]}"),
    )
    site = corner + (np.array(SITES["aa:01"]) - (20.0, 10.0) - corner) @ turn
    assert np.hypot(*(np.array(data["stations"][0]["position_m"]) - site)) < 8.0
    assert not any("occupied or unknown" in each for each in data["warnings"])
    problem = planopt.load(tmp_path / "mine.toml")
    assert planopt.solve(problem, horizon=2).verdict is planopt.Verdict.VERIFIED
    assert problem.channel.origin_deg == origin


def test_buildings_in_degrees(yard: Path, tmp_path: Path, capsys) -> None:
    """GeoJSON as RFC 7946 describes is projected by the origin of the log."""
    ring = np.array([[5.0, 10.0], [15.0, 10.0], [15.0, 30.0], [5.0, 30.0], [5.0, 10.0]])
    shape = {"type": "Polygon", "coordinates": [longitude_latitude_deg(ring, ORIGIN).tolist()]}
    (tmp_path / "houses.geojson").write_text(json.dumps(shape))
    imported(
        *(capsys, "--map", tmp_path / "houses.geojson", "--log", yard / "log.csv"),
        *("--origin", "48.1374,11.5755", "--out", tmp_path / "mine.toml"),
        *(f"--start={START}", f"--goal={GOAL}"),
    )
    (house,) = planopt.load(tmp_path / "mine.toml").workspace.obstacles
    np.testing.assert_allclose(house.polygon.bounds, (5.0, 10.0, 15.0, 30.0), atol=0.01)
