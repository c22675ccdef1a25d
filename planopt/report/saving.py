"""Write figures to files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from planopt.errors import InputError
from planopt.files.whole import write_whole
from planopt.report.panel import write

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 110
"""Resolution of pixel formats."""

UNDATED: dict[str, dict[str, None]] = {
    ".png": {},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}
"""Formats, and the date that is left out of their metadata."""


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure, whole or not at all.

    Parameters
    ----------
    figure
        From any of the ``draw_*`` functions.
    path
        Ends in ``.png``, ``.svg`` or ``.pdf``; its folder is made if need be.

    Raises
    ------
    InputError
        Another ending.
    OutputError
        The file cannot be written.
    """
    metadata = UNDATED.get(path.suffix.lower())
    if metadata is None:
        raise InputError(
            f"{path.name}: figures cannot be written as {path.suffix or 'a file without ending'!r}",
            remedy=f"end the name in one of {', '.join(UNDATED)}",
        )
    write_whole(path, lambda temporary: write(figure, temporary, dpi=DPI, metadata=metadata))
