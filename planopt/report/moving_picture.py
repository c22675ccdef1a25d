"""A figure whose lines move, saved as a short animation (GIF)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np

from planopt.files.whole import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FRAMES, FRAMES_PER_S = 90, 10
"""At most so many pictures, so many a second; the last one stays for a second."""

DPI = 70


class Line(Protocol):
    """The method of ``matplotlib.lines.Line2D`` that moves it, typed."""

    def set_data(self, x: object, y: object, /) -> None:
        """Move it to places x (n,) and y (n,)."""
        ...


class Segments(Protocol):
    """The method of ``matplotlib.collections.LineCollection`` that moves it, typed."""

    def set_segments(self, segments: object, /) -> None:
        """Make it of other lines, each (k, 2)."""
        ...


class _Writer(Protocol):
    """The methods of ``matplotlib.animation.PillowWriter`` that are used, typed."""

    def setup(self, figure: Figure, outfile: str, *, dpi: float) -> None: ...
    def grab_frame(self) -> None: ...
    def finish(self) -> None: ...


class _Drawn(Protocol):
    """The method of a canvas that draws it."""

    def draw(self) -> None: ...


class _LaidOut(Protocol):
    """The method of a figure that says how it is laid out, typed."""

    def set_layout_engine(self, layout: str, /) -> None: ...


def save_moving(figure: Figure, path: Path, count: int, show: Callable[[int], None]) -> None:
    """Write a figure as it changes, whole or not at all."""
    from matplotlib.animation import PillowWriter

    last = count - 1
    steps = np.unique(np.linspace(0, last, min(FRAMES, count)).round().astype(np.int64))

    def write(temporary: Path) -> None:
        writer = cast(_Writer, PillowWriter(fps=FRAMES_PER_S))
        writer.setup(figure, str(temporary), dpi=DPI)
        # Laid out once: panels would move, and layout takes most of the time.
        show(0)
        cast(_Drawn, figure.canvas).draw()
        cast(_LaidOut, figure).set_layout_engine("none")
        for step in [*steps.tolist(), *[last] * FRAMES_PER_S]:
            show(step)
            writer.grab_frame()
        writer.finish()

    write_whole(path, write)
