"""Logs of known programs, written after their documentation: text, SQLite, Parquet, frames."""

import contextlib
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from planopt import InputError
from planopt.channel import LogFormat, Station, read_log
from planopt.channel.logs.power_log import read_power_log
from planopt.channel.logs.readers import READERS, read_stations

ORIGIN = (48.1374, 11.5755)
NORTH = 100.1  # Metres from latitude 48.1374 to 48.1383

WIGLE = """WigleWifi-1.6,appRelease=2.78,model=X,release=11,device=f,display=O,board=s,brand=M
MAC,SSID,AuthMode,FirstSeen,Channel,Frequency,RSSI,CurrentLatitude,CurrentLongitude,AltitudeMeters,AccuracyMeters,RCOIs,MfgrId,Type
1a:9f:ee:5c:71:c6,"A, B",[WPA2-EAP-CCMP][ESS],2018-08-01 13:08:27,161,5805,-43,48.1374,11.5755,8.83,3.216,,,WIFI
1a:9f:ee:5c:71:c6,"A, B",[WPA2-EAP-CCMP][ESS],2018-08-01 13:08:29,161,5805,-50,48.1383,11.5755,8.83,6.0,,,WIFI
1a:9f:ee:5c:71:c6,"A, B",[WPA2-EAP-CCMP][ESS],2018-08-01 13:08:31,161,5805,-50,0.0,0.0,0,0,,,WIFI
1a:9f:ee:5c:71:c6,"A, B",[WPA2-EAP-CCMP][ESS],2018-08-01 13:08:33,161,5805,0,48.1383,11.5755,8,9,,,WIFI
1a:9f:ee:5c:71:c7,C,[ESS],2018-08-01 13:08:29,161,5805,-90,48.1383,11.5755,8.83,6.0,,,WIFI
"""  # noqa: E501

OLD_WIGLE = """WigleWifi-1.4,appRelease=2.53,model=X,release=11,device=f,display=O,board=s,brand=M
MAC,SSID,AuthMode,FirstSeen,Channel,RSSI,CurrentLatitude,CurrentLongitude,AltitudeMeters,AccuracyMeters,Type
1a:9f:ee:5c:71:c6,S,[ESS],2018-08-01 13:08:27,161,-43,48.1374,11.5755,8.83,3.216,WIFI
1a:9f:ee:5c:71:c6,S,[ESS],2018-08-01 13:08:29,161,-50,48.1383,11.5755,8.83,6.0,WIFI
"""

CELLMAPPER = """latitude,longitude,altitude,MCC,MNC,LAC,CID,signal,type,subtype,ARFCN,PSC
48.1374,11.5755,520,262,1,4711,25865217,-43,LTE,B3,1300,12
48.1383,11.5755,520,262,1,4711,25865217,-50,LTE,B3,1300,12
"""

SURVEY = "deviceTime,latitude,longitude,altitude,missionId,recordNumber,accuracy,"


def survey(own: str, cells: str) -> str:
    """A log of Network Survey: comments, header, rows; the last row has no position yet."""
    rows = [
        f"2024-05-01T10:00:00.000+02:00,48.1374,11.5755,520,NS 1,1,3.216,{cells.format(-43)}",
        f"2024-05-01T10:00:02.000+02:00,48.1383,11.5755,520,NS 1,2,6.0,{cells.format(-50)}",
        f"2024-05-01T10:00:04.000+02:00,,,,NS 1,3,,{cells.format(-60)}",
        f"2024-05-01T10:00:06.000+02:00,48.1383,11.5755,520,NS 1,4,6.0,{cells.format('')}",
    ]
    return "\n".join(["# CSV Version=1.0.0", SURVEY + own, *rows])


CELLULAR = "groupNumber,servingCell,provider,mcc,mnc,"
RANGE_TEST = "time,from,sender name,sender lat,sender long,rx lat,rx long,rx elevation,rx snr"

LOGS = {
    "wigle": (WIGLE, {"where": (("MAC", "1a:9f:ee:5c:71:c6"),)}),
    "wigle of 2017": (OLD_WIGLE, {}),
    "cellmapper": (CELLMAPPER, {}),
    "network_survey_gsm": (
        survey(CELLULAR + "lac,ci,arfcn,bsic,signalStrength,ta", "1,true,P,262,1,9,77,20,5,{},1"),
        {},
    ),
    "network_survey_umts": (
        survey(
            CELLULAR + "lac,cid,uarfcn,psc,rscp,ecno,signalStrength",
            "1,true,P,262,1,9,77,20,5,{},-5,-9",
        ),
        {},
    ),
    "network_survey_lte": (
        survey(
            CELLULAR + "tac,eci,earfcn,pci,rsrp,rsrq,ta,signalStrength,lteBandwidth",
            "1,true,P,262,1,9,77,1300,5,{},-9,1,-20,20",
        ),
        {},
    ),
    "network_survey_nr": (
        survey(
            CELLULAR + "tac,nci,narfcn,pci,ssRsrp,ssRsrq,ssSinr,csiRsrp,csiRsrq,csiSinr,ta",
            "1,true,P,262,1,9,77,6300,5,{},-9,1,,,,",
        ),
        {},
    ),
    "network_survey_wifi": (
        survey(
            "sourceAddress,destinationAddress,bssid,ssid,channel,frequencyMhz,signalStrength",
            'a,b,1a:9f,"N, O",36,5180,{}',
        ),
        {},
    ),
    "network_survey_bluetooth": (
        survey(
            "sourceAddress,destinationAddress,signalStrength,txPower,technology,otaDeviceName",
            "1a:9f,,{},4,BLE,beacon",
        ),
        {},
    ),
    "meshtastic_snr": (
        f"{RANGE_TEST},distance,hop limit,payload\n"
        "19:57:29,-1468062744,u,48.2,11.6,48.1374,11.5755,80,-43,11972,0,seq 1\n"
        '19:57:31,-1468062744,u,48.2,11.6,48.1383,11.5755,80,-50,11972,0,"seq 2"\n',
        {},
    ),
    "meshtastic": (
        f"{RANGE_TEST},distance,hop limit,payload,rx rssi\n"
        "19:57:29,-1468062744,u,48.2,11.6,48.1374,11.5755,80,-9.0,11972,0,seq 1,-43\n"
        "19:57:31,-1468062744,u,48.2,11.6,48.1383,11.5755,80,-9.5,11972,0,seq 2,-50\n",
        {},
    ),
}


@pytest.mark.parametrize("name", LOGS)
def test_programs(name: str, tmp_path: Path) -> None:
    """Two readings, recognised without any option but the origin; times and accuracies too."""
    text, options = LOGS[name]
    path = tmp_path / "log.csv"
    path.write_text(text)
    log = read_power_log(path, LogFormat(origin_deg=ORIGIN, **options))
    assert log.columns.reader_name == name.removesuffix(" of 2017")
    found = log.measurements
    np.testing.assert_allclose(found.positions_m, [[0.0, 0.0], [0.0, NORTH]], atol=0.05)
    np.testing.assert_array_equal(found.power_dbm, [-43.0, -50.0])
    if log.columns.time is not None:
        np.testing.assert_allclose(found.time_s, [0.0, 2.0])
    if log.columns.accuracy is not None:
        assert found.position_std_m[1] / found.position_std_m[0] == pytest.approx(6.0 / 3.216)


def test_every_reader_is_tested_and_documented() -> None:
    """wifi_logger has a test of its own, recordings are in test_recordings.py."""
    elsewhere = {"wifi_logger", "recording", "recording_gps"}
    tested = {name.removesuffix(" of 2017") for name in LOGS} | elsewhere
    assert tested == set(READERS.names())
    page = (Path(__file__).parents[2] / "docs" / "channel.md").read_text()
    assert all(f"`{name}`" in page for name in tested)


def database(path: Path, *statements: str) -> Path:
    connection = sqlite3.connect(path)
    for statement in statements:
        connection.execute(statement)
    connection.commit()
    connection.close()
    return path


WIFI_TABLE = (
    "CREATE TABLE wifi_data (id INTEGER PRIMARY KEY AUTOINCREMENT, timestamp TEXT, x REAL, "
    "y REAL, lat REAL, lon REAL, gps_status INT, bit_rate REAL, link_quality REAL, "
    "signal_level REAL)"
)
INSERT = "INSERT INTO wifi_data (timestamp, x, y, bit_rate, link_quality, signal_level) VALUES "


def test_wifi_logger(tmp_path: Path) -> None:
    """The table of the program among others; rows without a position are no readings."""
    path = database(
        tmp_path / "wifi_data.db",
        "CREATE TABLE notes (x TEXT, y TEXT)",
        WIFI_TABLE,
        f"{INSERT} ('2026-03-14 09:26:53', 1.5, -2.25, 300, 0.9, -43)",
        f"{INSERT} ('2026-03-14 09:26:55', 0.1, 4.0, 300, 0.9, -50.5)",
        f"{INSERT} ('2026-03-14 09:26:57', NULL, NULL, 300, 0.9, -50)",
    )
    log = read_power_log(path)
    assert log.columns.reader_name == "wifi_logger"
    np.testing.assert_array_equal(log.measurements.positions_m, [[1.5, -2.25], [0.1, 4.0]])
    np.testing.assert_array_equal(log.measurements.power_dbm, [-43.0, -50.5])
    np.testing.assert_array_equal(log.measurements.time_s, [0.0, 2.0])


ENDLESS = (
    "WITH RECURSIVE c(x, y, rssi) AS (SELECT 1, 1, 1 UNION ALL SELECT x + 1, 1, 1 FROM c) "
    "SELECT x, y, rssi FROM c"
)


@pytest.mark.parametrize(
    ("statements", "words"),
    [
        (["CREATE TABLE t (a TEXT)"], "no table with positions and powers among t"),
        ([f"CREATE VIEW v AS {ENDLESS}"], "no table with positions and powers among none"),
        (["CREATE TABLE t (x REAL, y REAL, rssi REAL)"], "no rows"),
    ],
)
def test_databases_that_are_no_logs(statements: list[str], words: str, tmp_path: Path) -> None:
    """Views are not run; errors name the file."""
    path = database(tmp_path / "log.sqlite", *statements)
    with pytest.raises(InputError, match=words) as caught:
        read_log(path)
    assert caught.value.file == str(path)


@pytest.mark.parametrize("ending", ["db", "sqlite", "parquet"])
@pytest.mark.parametrize("content", [b"", b"x,y,rssi\n1,2,-60\n", b"SQLite format 3\0" + bytes(99)])
def test_damaged_binary_files(ending: str, content: bytes, tmp_path: Path) -> None:
    """One error of ours that names the file."""
    path = tmp_path / f"log.{ending}"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_log(path)
    assert caught.value.file == str(path)


@pytest.mark.parametrize("ending", ["csv", "db", "parquet"])
def test_any_damage(ending: str, tmp_path: Path) -> None:
    """Hundreds of files with random bytes changed or cut off: an error of ours or a log."""
    path = tmp_path / f"log.{ending}"
    if ending == "parquet":
        pytest.importorskip("pyarrow")
        pytest.importorskip("pandas").DataFrame(ROWS).to_parquet(path)
    elif ending == "db":
        database(path, WIFI_TABLE, f"{INSERT} ('2026-03-14 09:26:53', 1, 2, 300, 0.9, -43)")
    else:
        path.write_text(WIGLE)
    sound, generator = path.read_bytes(), np.random.default_rng(0)
    for _ in range(300):
        damaged = bytearray(sound)
        for at in generator.integers(len(sound), size=generator.integers(1, 12)):
            damaged[at] = generator.integers(256)
        end = len(sound) if generator.random() < 0.8 else generator.integers(len(sound))
        path.write_bytes(damaged[:end])
        with contextlib.suppress(InputError):
            read_log(path, LogFormat(origin_deg=ORIGIN))


ROWS = {"x": [1.5, -3.0], "y": [2.0, 4.0], "rssi": [-60, -70], "ap": ["a", "b"]}


def test_frames_and_parquet(tmp_path: Path) -> None:
    """The same readings from a DataFrame, and from the Parquet file that it writes."""
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    dates = pandas.to_datetime(["2026-03-14 09:26:53.0", "2026-03-14 09:26:55.5"])
    frame = pandas.DataFrame({**ROWS, "when": dates, "low": [False, True]})
    frame.to_parquet(tmp_path / "log.parquet")
    form = LogFormat(time_column="when", censored_column="low")
    for source in (frame, tmp_path / "log.parquet"):
        found = read_log(source, form)
        np.testing.assert_array_equal(found.positions_m, [[1.5, 2.0], [-3.0, 4.0]])
        np.testing.assert_array_equal(found.power_dbm, [-60.0, -70.0])
        np.testing.assert_array_equal(found.time_s, [0.0, 2.5])
        np.testing.assert_array_equal(found.censored, [False, True])
        chosen = read_log(source, LogFormat(where=(("ap", "b"),)))
        np.testing.assert_array_equal(chosen.power_dbm, [-70.0])


def test_frames_that_are_no_logs() -> None:
    """Missing values and columns are named; other objects are refused."""
    pandas = pytest.importorskip("pandas")
    with pytest.raises(InputError, match="is empty"):
        read_log(pandas.DataFrame({**ROWS, "rssi": [None, -60.0]}))
    with pytest.raises(InputError, match="is not a column"):
        read_log(pandas.DataFrame({"x": [1.0], "y": [2.0]}))
    with pytest.raises(InputError, match="a int is no log"):
        read_log(3)  # pyright: ignore[reportArgumentType]


class Points(list):
    """Stand-in for a GeoSeries of points."""

    name = "geometry"

    def __init__(self, places: list[tuple[float, float]], kind: str = "Point") -> None:
        super().__init__(places)
        self.x, self.y = ([place[axis] for place in places] for axis in (0, 1))
        self.geom_type = np.array([kind] * len(places))

    def to_crs(self, code: int) -> "Points":
        assert code == 4326
        return Points([(11.5755, 48.1374), (11.5755, 48.1383)])


class GeoFrame(dict):
    """Stand-in for a GeoDataFrame."""

    crs: object = "EPSG:25832"

    @property
    def columns(self) -> list[str]:
        return list(self)

    @property
    def geometry(self) -> Points:
        return self["geometry"]


def test_frames_of_points() -> None:
    """Any reference system becomes degrees; points without one are metres."""
    frame = GeoFrame({"geometry": Points([(3.0, 4.0), (5.0, 6.0)]), "x": [0, 0], "rssi": [-1, -2]})
    found = read_log(frame, LogFormat(origin_deg=ORIGIN))
    np.testing.assert_allclose(found.positions_m, [[0.0, 0.0], [0.0, NORTH]], atol=0.05)
    frame.crs = None
    np.testing.assert_array_equal(read_log(frame).positions_m, [[3.0, 4.0], [5.0, 6.0]])
    frame["geometry"] = Points([(3.0, 4.0), (5.0, 6.0)], "Polygon")
    with pytest.raises(InputError, match="no points"):
        read_log(frame)


OPENCELLID = """radio,mcc,net,area,cell,unit,lon,lat,range,samples,changeable,created,updated,averageSignal
LTE,262,2,801,77,0,11.5755,48.1383,1000,7,1,1282569574,1300175362,0
GSM,262,2,801,78,0,11.5755,48.1374,1000,7,1,1282569574,1300175362,0
"""  # noqa: E501


def test_stations_from_tables(tmp_path: Path) -> None:
    """Cells of OpenCelliD by their number, and anchors in metres with decimal commas."""
    path = tmp_path / "cells.csv"
    path.write_text(OPENCELLID)
    found = read_stations(path, ["77", "99"], ORIGIN)
    assert list(found) == ["77"]
    np.testing.assert_allclose(found["77"].position_m, [0.0, NORTH], atol=0.05)
    path.write_text(OPENCELLID + "LTE,262,1,9,77,0,11.57,48.13,1000,7,1,1,1,0\n")
    with pytest.raises(InputError, match="'77' has several positions"):
        read_stations(path, ["77"], ORIGIN)
    with pytest.raises(InputError, match="--origin"):
        read_stations(path, ["78"])
    path = tmp_path / "anchors.csv"
    path.write_text("anchor;x_m;y_m;height_m\n1;1,5;2;0,8\n2;3;4;\n")
    found = read_stations(path, ["1", "2"])
    assert found == {"1": Station((1.5, 2.0), 0.8), "2": Station((3.0, 4.0))}
    path.write_text("x_m,y_m\n1,2\n")
    with pytest.raises(InputError, match="no columns of names of transmitters"):
        read_stations(path, ["1"])
