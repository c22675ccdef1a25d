"""Cells of a power log as what they stand for, or an error that says where they stand."""

from __future__ import annotations

import math
from pathlib import Path

from planopt.errors import InputError

FLAGS = {"1": True, "true": True, "0": False, "false": False}
"""What a column of flags may contain, in any case."""


def read_number(text: str, file: Path, line: int, name: str) -> float:
    """Return the finite number in a cell; `line` and `name` say in which row and column it is."""
    cell = read_label(text, file, line, name)
    try:
        # Python would read 1_0 as 10.
        number = math.nan if "_" in cell else float(cell)
    except ValueError:
        raise InputError(f"{cell!r} is not a number", file=file, key=name, row=line) from None
    if not math.isfinite(number):
        raise InputError(
            f"{cell!r} is not a finite number",
            file=file,
            key=name,
            row=line,
            remedy="remove the row, or mark it censored at the receiver's floor",
        )
    return number


def read_flag(text: str, file: Path, line: int, name: str) -> bool:
    """Return the flag in a cell, as :func:`read_number`."""
    flag = FLAGS.get(text.strip().lower())
    if flag is None:
        raise InputError(
            f"{text.strip()!r} is not a flag", file=file, key=name, row=line, remedy="use 0 or 1"
        )
    return flag


def read_label(text: str, file: Path, line: int, name: str) -> str:
    """Return the text in a cell, as :func:`read_number`; it is not empty and can be printed."""
    cell = text.strip()
    if not cell:
        raise InputError("the cell is empty", file=file, key=name, row=line)
    if not cell.isprintable():
        raise InputError(
            f"{cell!a} has a character that cannot be printed", file=file, key=name, row=line
        )
    return cell
