"""Tables of declared columns as files."""

from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from planopt.extend import Column
from planopt.files.tables import read_table, table_text

COLUMNS = (
    Column("robot", "its name", kind="text"),
    Column("step", "its number", kind="count", required=True),
    Column("t_s", "time", "s", required=True),
    Column("b", "a number that may be missing"),
    Column("on", "whether it is on", kind="flag"),
)
HEADER = "robot,step,t_s,b,on\n"


def test_what_is_written_is_read(tmp_path: Path) -> None:
    """To the last digit, and NaN where there is no number."""
    table = {
        "robot": np.array(["one", "other"]),
        "step": np.array([0, 1]),
        "t_s": np.array([0.0, 0.1 + 0.2]),
        "b": np.array([np.nan, -1e-300]),
        "on": np.array(["", "1"]),
    }
    path = tmp_path / "table.csv"
    path.write_text(table_text(COLUMNS, table))
    assert path.read_text().startswith(HEADER)
    back = read_table(path, COLUMNS)
    for name, column in table.items():
        np.testing.assert_array_equal(back[name], column)


@pytest.mark.parametrize(
    "text",
    [
        "a,b\n",
        HEADER + "r,1\n",
        HEADER + "r,1,x,,\n",
        HEADER + "r,1,0,inf,\n",
        HEADER + "r,1,,1,\n",
        HEADER + "r,1.5,0,1,\n",
        HEADER + "r,1,0,1,yes\n",
    ],
)
def test_what_cannot_be_read(tmp_path: Path, text: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    with refused():
        read_table(path, COLUMNS)
    with refused():
        read_table(tmp_path / "missing.csv", COLUMNS)
