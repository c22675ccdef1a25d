"""Tables of numbers as files."""

from pathlib import Path

import numpy as np
import pytest

from planopt.errors import InputError
from planopt.planning.files.steps_file import read_table, table_text


def test_what_is_written_is_read(tmp_path: Path) -> None:
    """To the last digit, and NaN where there is no number."""
    table = {"t_s": np.array([0.0, 0.1 + 0.2]), "b": np.array([np.nan, -1e-300])}
    path = tmp_path / "table.csv"
    path.write_text(table_text(table))
    back = read_table(path, ("t_s", "b"))
    for name, column in table.items():
        np.testing.assert_array_equal(back[name], column)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b\n", "header is not t_s,b"),
        ("t_s,b\n1\n", "1 cells where 2"),
        ("t_s,b\n1,x\n", "'x' is not a finite number"),
        ("t_s,b\n1,inf\n", "'inf' is not a finite number"),
    ],
)
def test_what_cannot_be_read(tmp_path: Path, text: str, words: str) -> None:
    """File, row and column are named."""
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_table(path, ("t_s", "b"))
    with pytest.raises(InputError, match="there is no such file"):
        read_table(tmp_path / "missing.csv", ("t_s",))
