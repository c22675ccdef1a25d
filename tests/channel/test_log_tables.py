"""Tables of logs: delimiters, decimal commas, names of columns, units, times and transmitters."""

from pathlib import Path

import numpy as np
import pytest

from planopt import InputError
from planopt.channel import LogFormat, read_log
from planopt.channel.logs.power_log import read_power_log

ROWS = [("lat", "lon", "rssi"), (48.1374, 11.5755, -60.0), (48.1383, 11.5755, -70.5)]
ORIGIN = (48.1374, 11.5755)


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    return path


def refused(path: Path, **options: object) -> InputError:
    with pytest.raises(InputError) as caught:
        read_log(path, LogFormat(**options))  # pyright: ignore[reportArgumentType]
    return caught.value


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " ", "  "])
def test_delimiters(delimiter: str, tmp_path: Path) -> None:
    """The same places, whatever stands between the cells."""
    text = "\n".join(delimiter.join(map(str, row)) for row in ROWS)
    log = read_log(written(tmp_path, text), LogFormat(origin_deg=ORIGIN))
    np.testing.assert_allclose(log.positions_m, [[0.0, 0.0], [0.0, 100.1]], atol=0.05)
    np.testing.assert_array_equal(log.power_dbm, [-60.0, -70.5])


def test_decimal_commas(tmp_path: Path) -> None:
    """With semicolons, tabs or quotes; Excel may name the delimiter in the first line."""
    plain = "x;y;rssi\n1,5;2;-60,25\n-3,25;4,0;-7e1\n"
    expected = [[1.5, 2.0], [-3.25, 4.0]]
    for text in (
        plain,
        f"sep=;\n{plain}",
        plain.replace(";", "\t"),
        'x,y,rssi\n"1,5",2,"-60,25"\n"-3,25","4,0",-7e1\n',
    ):
        log = read_log(written(tmp_path, text))
        np.testing.assert_array_equal(log.positions_m, expected)
        np.testing.assert_array_equal(log.power_dbm, [-60.25, -70.0])


def test_wrong_columns_and_cells_are_located(tmp_path: Path) -> None:
    """Two kinds of decimal marks, a missing column, and a text that is no date."""
    error = refused(written(tmp_path, "x;y;rssi\n1,5;2;-60\n1.5;2;-61\n"))
    assert (error.row, error.key) == (2, "x")
    assert "'1,5' has a decimal comma, but '1.5' in line 3 has a point" in error.message
    error = refused(written(tmp_path, "x,y,quality\n1,2,50\n"))
    assert error.message == "is not a column; the columns are x, y, quality"
    assert error.row == 1
    path = written(tmp_path, "x,y,rssi,when\n1,2,-60,2026-03-14\n3,4,-70,tomorrow\n")
    error = refused(path, time_column="when")
    assert (error.row, error.key) == (3, "when") and "is not a date" in error.message


@pytest.mark.parametrize(
    "header",
    [
        "x_m,y_m,power_dbm",
        "X,Y,RSSI",
        "pos_x,pos_y,rsrp (dBm)",
        "pose.position.x,pose.position.y,signal_level",
        "East,North,dBm",
        "map_x,map_y,Signal Strength",
    ],
)
def test_names_of_columns_in_metres(header: str, tmp_path: Path) -> None:
    """Usual names need no option; letters' case and other signs do not count."""
    log = read_power_log(written(tmp_path, f"{header},id\n1,2,-60,a\n3,4,-70,b\n"))
    np.testing.assert_array_equal(log.measurements.positions_m, [[1, 2], [3, 4]])
    assert log.columns.power == header.split(",")[2]


@pytest.mark.parametrize(
    "header",
    ["lat,lon,power", "Latitude,Longitude,RSSI", "gps_lat,lng,rsrp", "Breitengrad,Längengrad,dBm"],
)
def test_names_of_columns_in_degrees(header: str, tmp_path: Path) -> None:
    """Degrees need an origin, and the error says so; latitude and longitude are not confused."""
    path = written(tmp_path, f"{header}\n48.1374,11.5755,-60\n48.1383,11.5755,-70\n")
    if "ä" not in header:  # Letters with marks are not folded
        error = refused(path)
        assert "are in degrees" in error.message and "--origin" in str(error.remedy)
        log = read_log(path, LogFormat(origin_deg=ORIGIN))
        np.testing.assert_allclose(log.positions_m, [[0.0, 0.0], [0.0, 100.1]], atol=0.05)


def test_metres_and_degrees_in_one_log(tmp_path: Path) -> None:
    """Metres are used without an origin, degrees with one."""
    path = written(tmp_path, "x,y,lat,lon,rssi\n5,6,48.1374,11.5755,-60\n7,8,48.1383,11.5755,-70\n")
    np.testing.assert_array_equal(read_log(path).positions_m, [[5, 6], [7, 8]])
    log = read_log(path, LogFormat(origin_deg=ORIGIN))
    np.testing.assert_allclose(log.positions_m, [[0.0, 0.0], [0.0, 100.1]], atol=0.05)


@pytest.mark.parametrize(
    ("name", "unit"), [("power_mW", None), ("power", "mW"), ("rx_power_mw", None), ("power", None)]
)
def test_milliwatts(name: str, unit: str | None, tmp_path: Path) -> None:
    """From the column's name or values or from the option; zero has no logarithm."""
    path = written(tmp_path, f"x,y,{name}\n1,2,1\n3,4,1e-6\n")
    columns = (None, None, name)
    log = read_log(path, LogFormat(columns, power_unit=unit))  # pyright: ignore[reportArgumentType]
    np.testing.assert_allclose(log.power_dbm, [0.0, -60.0])
    path = written(tmp_path, f"x,y,{name}\n1,2,1\n3,4,0\n")
    error = refused(path, columns=columns, power_unit=unit)
    assert (error.row, error.key) == (3, name) and "above 0" in error.message


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ("0.5", "3", [0.5, 3.0]),
        ("1700000000", "1700000002.5", [0.0, 2.5]),
        ("1700000000000", "1700000002500", [0.0, 2.5]),
        ("1700000000000000", "1700000002500000", [0.0, 2.5]),
        ("1700000000000000000", "1700000002500000000", [0.0, 2.5]),
        ("2026-03-14T09:26:53", "2026-03-14T09:26:55.5", [0.0, 2.5]),
        ("2026-03-14 09:26:53Z", "2026-03-14 09:26:55.500Z", [0.0, 2.5]),
        ("14.03.2026 09:26:53", "14.03.2026 09:26:55", [0.0, 2.0]),
        ("09:26:55", "09:26:53", [2.0, 0.0]),
    ],
)
def test_times(first: str, second: str, expected: list[float], tmp_path: Path) -> None:
    """Seconds as they are; Unix times in any unit and dates from the earliest."""
    path = written(tmp_path, f"x,y,rssi,when\n1,2,-60,{first}\n3,4,-70,{second}\n")
    found = read_log(path, LogFormat(time_column="when")).time_s
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_accuracies(tmp_path: Path) -> None:
    """A radius with 68 % contains two normal coordinates with 68 %; empty cells take the option."""
    path = written(tmp_path, "x,y,rssi,acc\n1,2,-60,3\n3,4,-70,\n")
    found = read_log(path, LogFormat(accuracy_column="acc", position_std_m=0.5)).position_std_m
    assert found[1] == 0.5
    places = np.random.default_rng(0).normal(0.0, found[0], (200_000, 2))
    assert np.mean(np.linalg.norm(places, axis=1) < 3.0) == pytest.approx(0.68, abs=0.005)
    path = written(tmp_path, "x,y,rssi,acc\n1,2,-60,-3\n")
    assert "accuracy is negative" in refused(path, accuracy_column="acc").message


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"resolution_db": -1.0}, "resolution_db"),
        ({"floor_dbm": float("nan")}, "floor_dbm"),
        ({"columns": ("x", "y")}, "columns"),
        ({"columns": "xyz"}, "columns"),
        ({"origin_deg": (90.0, 0.0)}, "origin_deg[0]"),
        ({"power_unit": "watt"}, "power_unit"),
        ({"position_std_m": "wide"}, "position_std_m"),
    ],
)
def test_formats_that_are_none(options: dict[str, object], key: str) -> None:
    """Values are checked as in a problem file, where they have the same keys."""
    with pytest.raises(InputError) as caught:
        LogFormat(**options)  # pyright: ignore[reportArgumentType]
    assert caught.value.key == f"channel.measurements.{key}"
