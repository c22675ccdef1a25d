"""Conversion of a log's seconds, Unix times or dates to seconds from the first one."""

from collections.abc import Iterable
from datetime import datetime

import numpy as np

from planopt.arrays import Floats
from planopt.channel.logs.log_table import Cell

UNIX_SCALES = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3), (1e8, 1.0))
"""Smallest Unix times in ns, us, ms and s (from 1973 on), each with its unit in seconds."""
DATES = ("%d.%m.%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S", "%H:%M:%S", "%H:%M:%S.%f")
"""Accepted date formats in addition to ISO 8601."""


def times_s(cells: Iterable[Cell]) -> Floats:
    """Return the times in seconds; Unix times and dates count from the earliest."""
    cells = list(cells)
    first = cells[0].label()
    if _date(first) is not None and not _is_number(first):
        return _from_earliest(np.array([_date_s(cell) for cell in cells]))
    numbers = np.array([cell.number() for cell in cells])
    for least, unit_s in UNIX_SCALES:
        if np.abs(numbers).min() >= least:
            return _from_earliest(numbers) * unit_s
    return numbers


def _from_earliest(values: Floats) -> Floats:
    return values - values.min()


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _date(text: str) -> datetime | None:
    """Return a date or a time of day; None if the text is neither."""
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        pass
    for form in DATES:
        try:
            return datetime.strptime(text, form)
        except ValueError:
            continue
    return None


def _date_s(cell: Cell) -> float:
    found = _date(cell.label())
    if found is None:
        raise cell.error(
            f"{cell.text.strip()!r} is not a date", "write dates as 2026-03-14T09:26:53"
        )
    since = datetime(1970, 1, 1, tzinfo=found.tzinfo)
    return (found - since).total_seconds()
