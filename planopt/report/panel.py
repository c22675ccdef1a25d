"""Figures and panels: Matplotlib as it is used here, typed; layout; files.

Matplotlib leaves the styling keywords of its methods untyped, which strict checking reports at
every call. The protocols below name the methods that are used, with types, and this file is the
only place where one is taken for the other. No pyplot: figures belong to the caller and are
collected like any other object.
"""

# ruff: noqa: D102 - matplotlib documents the methods that the protocols name

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.writing import write_whole

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axis import Axis
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import Collection
    from matplotlib.figure import Figure

DPI = 110
"""Resolution of pixel formats."""

UNDATED: dict[str, dict[str, None]] = {
    ".png": {},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}
"""Formats, and the date that is left out of their metadata."""

Values = NDArray[np.float64] | Sequence[float]
Look = dict[str, Any]
"""Keywords of Matplotlib that style what is drawn."""


class Panel(Protocol):
    """One set of axes: the methods of ``matplotlib.axes.Axes`` that are used here."""

    @property
    def xaxis(self) -> Axis: ...
    @property
    def yaxis(self) -> Axis: ...
    @property
    def transAxes(self) -> object: ...
    def plot(self, x: Values, y: Values, /, **look: object) -> Sequence[Artist]: ...
    def scatter(self, x: Values, y: Values, /, **look: object) -> Collection: ...
    def bar(self, x: Values, height: Values, /, **look: object) -> object: ...
    def barh(self, y: Values, width: Values, /, **look: object) -> object: ...
    def stairs(self, values: Values, edges: Values, /, **look: object) -> Artist: ...
    def errorbar(self, x: Values, y: Values, /, **look: object) -> object: ...
    def fill_between(
        self, x: Values, low: Values, high: Values | float, /, **look: object
    ) -> Collection: ...
    def imshow(self, values: NDArray[np.float64], /, **look: object) -> ScalarMappable: ...
    def contour(
        self, x: Values, y: Values, z: NDArray[np.float64], /, **look: object
    ) -> object: ...
    def axvspan(self, low: float, high: float, /, **look: object) -> object: ...
    def axhline(self, y: float, /, **look: object) -> Artist: ...
    def axvline(self, x: float, /, **look: object) -> Artist: ...
    def text(self, x: float, y: float, words: str, /, **look: object) -> Artist: ...
    def add_collection(self, collection: Collection, /, *, autolim: bool = True) -> object: ...
    def legend(self, **look: object) -> object: ...
    def get_legend_handles_labels(self) -> tuple[Sequence[Artist], Sequence[str]]: ...
    def inset_axes(self, bounds: tuple[float, float, float, float], /) -> Panel: ...
    def set_title(self, label: str, /, **look: object) -> object: ...
    def set_xlabel(self, label: str, /, **look: object) -> object: ...
    def set_ylabel(self, label: str, /, **look: object) -> object: ...
    def set_xlim(self, low: float, high: float, /) -> object: ...
    def set_ylim(self, low: float | None, high: float | None, /) -> object: ...
    def set_xticks(self, ticks: Values, /, labels: Sequence[str] | None = None) -> object: ...
    def set_yticks(self, ticks: Values, /, labels: Sequence[str] | None = None) -> object: ...
    def set_xscale(self, name: str, /) -> object: ...
    def set_yscale(self, name: str, /) -> object: ...
    def set_aspect(self, aspect: str, /, **look: object) -> object: ...
    def set_axisbelow(self, below: bool, /) -> None: ...
    def secondary_yaxis(self, location: str, /, **look: object) -> Panel: ...
    def set_axis_off(self) -> None: ...
    def tick_params(self, **look: object) -> None: ...
    def grid(self, visible: bool, /, **look: object) -> None: ...


def new_figure(
    width_in: float,
    height_in: float,
    mosaic: Sequence[Sequence[object]] = ("A",),
    *,
    maps_only: bool = False,  # Panels of equal scale leave gaps: move them together
    **ratios: Sequence[float],  # width_ratios, height_ratios of columns and rows
) -> tuple[Figure, list[Panel]]:
    """Return a figure and its panels; equal entries of the mosaic are one panel, "." is empty."""
    from matplotlib.figure import Figure

    layout = "compressed" if maps_only else "constrained"
    figure = Figure(figsize=(width_in, height_in), layout=layout)
    cells = [list(row) for row in mosaic]
    panels: dict[object, Panel] = cast("Any", figure).subplot_mosaic(cells, **ratios)
    names = dict.fromkeys(name for row in cells for name in row if name != ".")
    return figure, [panels[name] for name in names]


def split_panel(figure: Figure, panel: Panel, shares: Sequence[float]) -> list[Panel]:
    """Replace a panel by panels above each other, with these shares of its height."""
    from matplotlib.gridspec import GridSpecFromSubplotSpec

    axes = cast("Any", panel)
    cell = axes.get_subplotspec()
    axes.remove()
    rows = GridSpecFromSubplotSpec(len(shares), 1, cell, height_ratios=shares)
    return [cast("Any", figure).add_subplot(rows[row, 0]) for row in range(len(shares))]


def add_colorbar(figure: Figure, layer: ScalarMappable, panel: Panel, **look: object) -> Panel:
    """Add a colour bar next to `panel`; return its axes."""
    return cast("Any", figure).colorbar(layer, ax=panel, **look).ax


def add_legend(figure: Figure, **look: object) -> None:
    """Add a legend of the whole figure."""
    cast("Any", figure).legend(**look)


def add_title(figure: Figure, words: str, **look: object) -> None:
    """Add a title of the whole figure."""
    cast("Any", figure).suptitle(words, **look)


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
    write = cast("Any", figure).savefig
    write_whole(path, lambda temporary: write(temporary, dpi=DPI, metadata=metadata))
