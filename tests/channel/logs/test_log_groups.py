"""Groups of a log's rows by columns and blocks."""

import numpy as np
import pytest

from planopt import InputError
from planopt.channel.power_log import GroupColumn, parse_groups, read_groups

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
    """Five rows of two days."""
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


def test_parsed():
    """A block is a number, a name is not."""
    assert parse_groups("day, t_s:2.5") == (GroupColumn("day"), GroupColumn("t_s", 2.5))


@pytest.mark.parametrize("text", ["", "day,", ":600", "t_s:", "t_s:0", "t_s:-1", "t_s:x", "t:inf"])
def test_unreadable(text):
    """An error that says how to write it."""
    with pytest.raises(InputError, match="cannot read") as caught:
        parse_groups(text)
    assert caught.value.key == "--hold-out" and "BLOCK" in (caught.value.remedy or "")


def test_bad_cells(log):
    """A text where a block is asked for, and a column that is not there, name line and column."""
    with pytest.raises(InputError) as caught:
        read_groups(log, parse_groups("day:2"))
    assert (caught.value.row, caught.value.key) == (2, "day")
    with pytest.raises(InputError, match="week"):
        read_groups(log, parse_groups("week"))
