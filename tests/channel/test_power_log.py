"""Reading power logs: columns, errors, positions in degrees and groups of rows."""

from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from planopt import InputError
from planopt.channel import LogFormat, Station, read_log
from planopt.channel.estimation.least_squares import examine
from planopt.channel.logs.log_format import (
    GroupColumn,
    parse_columns,
    parse_groups,
    parse_station,
    parse_where,
)
from planopt.channel.logs.power_log import at_file_line, read_groups, read_power_log


def written(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "log.csv"
    path.write_bytes(text.encode(encoding))
    return path


def refuses(path, **options):
    """Reading raises an error of the table that names the file."""
    with refused() as caught:
        read_log(path, LogFormat(**options))
    assert caught.value.file == str(path)


def test_reads_what_is_there(tmp_path):
    """Other columns and order, comments, blank lines, quotes, spaces, CRLF and a mark are fine."""
    path = written(
        tmp_path,
        '# a comment\r\nday, power_dbm ,"x_m",y_m\r\n1,-70.5,1,2\r\n'
        '\r\n # more\r\n2,"-8e1",3,-4\r\n',
        "utf-8-sig",
    )
    log = read_log(path)
    np.testing.assert_array_equal(log.positions_m, [[1, 2], [3, -4]])
    np.testing.assert_array_equal(log.power_dbm, [-70.5, -80])
    assert not log.censored.any()


def test_named_columns_flags_and_floor(tmp_path):
    """Flags and floor both censor, the floor is the limit, and powers below it may be anything."""
    path = written(tmp_path, "e,n,rssi,cut\n0,0,-70,0\n1,0,-80,TRUE\n2,0,-99,false\n3,0,-95,1\n")
    log = read_log(path, LogFormat(("e", "n", "rssi"), censored_column="cut", floor_dbm=-95.0))
    np.testing.assert_array_equal(log.censored, [False, True, True, True])
    np.testing.assert_array_equal(log.power_dbm, [-70, -80, -95, -95])
    path = written(tmp_path, "x_m,y_m,power_dbm\n1,2,-70\n3,1,-999\n")
    measurements = read_log(path, LogFormat(floor_dbm=-110.0))
    assert measurements.power_dbm.tolist() == [-70.0, -110.0]
    assert measurements.censored.tolist() == [False, True]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "# nothing\n\n",
        "x_m,y_m,power_dbm\n",
        "x_m,y_m\n1,2\n",
        "x_m,y_m,x_m,power_dbm\n1,2,3,4\n",
        "# c\nx_m,y_m,power_dbm\n1,2,-70\n1,two,-70\n",
        "x_m,y_m,power_dbm\n1,2,nan\n",
        "x_m,y_m,power_dbm\n1,2,-inf\n",
        "x_m,y_m,power_dbm\n1_0,2,-7\n",
        "x_m,y_m,power_dbm\n1, ,-70\n",
        "x_m,y_m,power_dbm\n1,2\n",
        "x_m,y_m,power_dbm\n1,2,-70,9\n",
        'x_m,y_m,power_dbm\n1,2,"-70\n',
        "x_m,y_m,power_dbm\n1,2,\0\n",
    ],
)
def test_bad_content_is_located(tmp_path, text):
    """File, line and column stand in the error, with the offending text."""
    refuses(written(tmp_path, text))


def test_texts_that_cannot_be_read(tmp_path):
    """No file, a folder, bytes that are not UTF-8, wrong flags, and labels with terminal codes."""
    path = written(tmp_path, "x_m,y_m,power_dbm,cut\n1,2,-70,0\n1,2,-70,maybe\n")
    refuses(path, censored_column="cut")
    refuses(path, censored_column="floor")
    refuses(tmp_path / "absent.csv")
    refuses(tmp_path)
    path = tmp_path / "binary.csv"
    path.write_bytes(b"\x89PNG\xff\xfe")
    refuses(path)
    path = written(tmp_path, "x_m,y_m,power_dbm,rx\n1,2,-70,\x1b[2J\n")
    refuses(path, receiver_column="rx")


def test_times_receivers_and_what_holds_for_all(tmp_path):
    """Receivers are numbered as they appear; steps and errors are those of every row."""
    path = written(
        tmp_path,
        "t,who,x_m,y_m,power_dbm\n5,b,0,0,-70\n6, a ,1,0,-71\n7.5,b,2,0,-72\n9,c,3,0,-73\n",
    )
    log = read_power_log(
        path,
        LogFormat(time_column="t", receiver_column="who", resolution_db=1.0, position_std_m=2.5),
    )
    assert log.receivers == ("b", "a", "c")
    found = log.measurements
    np.testing.assert_array_equal(found.receiver, [0, 1, 0, 2])
    np.testing.assert_array_equal(found.time_s, [5.0, 6.0, 7.5, 9.0])
    np.testing.assert_array_equal(found.resolution_db, 1.0)
    np.testing.assert_array_equal(found.position_std_m, 2.5)
    plain = read_power_log(path)
    assert plain.receivers == ()
    for name in ("time_s", "receiver", "resolution_db", "position_std_m"):
        np.testing.assert_array_equal(getattr(plain.measurements, name), np.zeros(4))


@pytest.mark.parametrize(
    ("cells", "option"),
    [("soon,a", "time_column"), ("inf,a", "time_column"), ("1, ", "receiver_column")],
)
def test_bad_times_and_receivers(tmp_path, cells, option):
    """With file, line and column; a column that is missing, too."""
    path = written(tmp_path, f"x_m,y_m,power_dbm,t,who\n0,0,-70,0,a\n1,0,-70,{cells}\n")
    refuses(path, **{option: "t" if option == "time_column" else "who"})
    refuses(path, **{option: "absent"})


def test_an_index_becomes_a_line(tmp_path):
    """A measurement at the station is located in the file, also where only some rows were read."""
    path = written(tmp_path, "# c\nx_m,y_m,power_dbm\n1,2,-70\n\n# d\n0,0,-50\n3,4,-80\n")
    with pytest.raises(InputError) as caught:
        examine(read_log(path), Station((0.0, 0.0)))
    error = at_file_line(caught.value, path)
    assert (error.file, error.row) == (str(path), 6)
    assert "path loss is undefined" in str(error)
    assert at_file_line(InputError("no row"), path).row is None
    path = written(tmp_path, TRANSMITTERS)
    chosen = LogFormat(where=(("tx", "2"),))
    with pytest.raises(InputError) as caught:
        examine(read_log(path, chosen), Station((7.0, 8.0)))
    assert at_file_line(caught.value, path, chosen).row == 6


TRANSMITTERS = """x_m,y_m,power_dbm,tx,day
1,2,-70,1,mon
0,0,-50,2,mon
3,4,x,3,mon
5,6,-80, 1 ,tue
7,8,-90,2,tue
9,9,-91,2,wed
"""


def test_only_some_rows(tmp_path):
    """One of several transmitters is read as a log of its own is; other rows are not looked at."""
    path = written(tmp_path, TRANSMITTERS)
    for rows, lines in (
        ("tx=1", (1, 4)),
        ("tx=2", (2, 5, 6)),
        ("tx=2,day=tue", (5,)),
        ("day=wed", (6,)),
    ):
        chosen = LogFormat(where=parse_where(rows.split(",")))
        own = tmp_path / "own.csv"
        text = TRANSMITTERS.splitlines()
        own.write_text("\n".join([text[0], *(text[line] for line in lines)]))
        found, expected = read_log(path, chosen), read_log(own)
        np.testing.assert_array_equal(found.positions_m, expected.positions_m)
        np.testing.assert_array_equal(found.power_dbm, expected.power_dbm)
        groups = parse_groups("day")
        np.testing.assert_array_equal(
            read_groups(path, groups, chosen), read_groups(own, groups, LogFormat())
        )


def test_rows_that_are_not_there(tmp_path):
    """What the column has instead is said; so is a column that is missing, and a bad option."""
    path = written(tmp_path, TRANSMITTERS)
    refuses(path, where=(("tx", "4"),))
    refuses(path, where=(("receiver", "4"),))
    for text in ("tx", "tx=", "=4", ""):
        with refused():
            parse_where([text])


def test_options_of_columns_and_station():
    """Named columns replace defaults; a station is two or three finite numbers, or unknown."""
    assert parse_columns("x=east, y=north,power=rssi") == ("east", "north", "rssi")
    assert parse_columns("power=rssi") == (None, None, "rssi")
    for text in ("", "east", "x=", "z=up", "x=a,,y=b"):
        with refused():
            parse_columns(text)
    assert parse_station(" unknown ") is None
    assert parse_station("1,-2.5") == Station((1.0, -2.5))
    assert parse_station("1, 2, 30") == Station((1.0, 2.0), 30.0)
    for text in ("", "1", "1,2,3,4", "1,two", "1,nan", "inf,0"):
        with refused():
            parse_station(text)
    with refused():  # 48.1374,11.57 with a decimal comma
        parse_station("48.1374,11,57", (48.1, 11.6))


@pytest.mark.parametrize("row", ["3,1e11,-60", "3e300,1,-60", "3,1,970", "3,1,-999"])
def test_values_out_of_range(row: str, tmp_path) -> None:
    """File, line and column are named, and the range is."""
    refuses(written(tmp_path, f"# c\nx_m,y_m,power_dbm\n1,2,-70\n{row}\n"))


@pytest.mark.parametrize(
    ("row", "words", "key"),
    [
        ("91,11,-60", "91 degrees is out of range", "lat"),
        ("48,190,-60", "190 degrees is out of range", "lon"),
        ("11.5,48.1,-60", "is more than 100 km from the origin", None),
    ],
)
def test_places_that_cannot_be_meant(row: str, words: str, key: str | None, tmp_path: Path) -> None:
    """The line is named; so is the column where one is to blame."""
    path = tmp_path / "log.csv"
    path.write_text(f"lat,lon,power_dbm\n48.1,11.5,-60\n{row}\n")
    form = LogFormat(("lon", "lat", "power_dbm"), origin_deg=(48.1, 11.5))
    with refused():
        read_log(path, form)


LOG = """x_m,y_m,power_dbm,day,t_s
0,0,-50,mon,0
1,0,-50,mon,599.5
2,0,-50,mon,600
# a remark
3,0,-50,tue,10

4,0,-50, mon ,-1
"""


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(LOG)
    return path


@pytest.mark.parametrize(
    ("text", "labels"),
    [
        ("day", [0, 0, 0, 1, 0]),
        ("day,t_s:600", [0, 0, 1, 2, 3]),
        ("t_s:600", [0, 0, 1, 0, 2]),
        (" t_s:1e9 , day ", [0, 0, 0, 1, 2]),
    ],
)
def test_groups(log, text, labels):
    """Rows are together where all columns agree; blocks are counted from zero."""
    np.testing.assert_array_equal(read_groups(log, parse_groups(text)), labels)


def test_groups_by_names_and_blocks(log):
    """A block is a number, a name is not; wrong cells and columns are named."""
    assert parse_groups("day, t_s:2.5") == (GroupColumn("day"), GroupColumn("t_s", 2.5))
    with refused():
        read_groups(log, parse_groups("day:2"))
    with refused():
        read_groups(log, parse_groups("week"))


@pytest.mark.parametrize("text", ["", "day,", ":600", "t_s:", "t_s:0", "t_s:-1", "t_s:x", "t:inf"])
def test_unreadable(text):
    """An error that says how to write it."""
    with refused():
        parse_groups(text)
