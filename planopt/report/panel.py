"""Matplotlib as the figures use it, typed.

Matplotlib leaves the styling keywords of its methods untyped, which strict checking reports at
every call. The protocols below name the methods that are used, with types, and this file is the
only place where one is taken for the other. No pyplot: figures belong to whoever holds them and
are collected like any other object.
"""

# ruff: noqa: D102 - matplotlib documents the methods that the protocols name

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axis import Axis
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import Collection
    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

Values = NDArray[np.float64] | Sequence[float]


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


class _Sheet(Protocol):
    """The methods of ``matplotlib.figure.Figure`` whose keywords it leaves untyped."""

    def colorbar(self, layer: ScalarMappable, /, **look: object) -> Colorbar: ...
    def legend(self, **look: object) -> object: ...
    def suptitle(self, words: str, /, **look: object) -> object: ...
    def savefig(self, path: Path, /, **look: object) -> None: ...


def new_figure(width_in: float, height_in: float, *, maps_only: bool = False) -> Figure:
    """An empty figure of that size in inches, whose panels find room for their labels.

    Where all panels are maps they are moved together, since equal scales leave gaps.
    """
    from matplotlib.figure import Figure

    return Figure(
        figsize=(width_in, height_in), layout="compressed" if maps_only else "constrained"
    )


def add_panel(figure: Figure, cell: SubplotSpec) -> Panel:
    """A new panel in a cell of a grid."""
    return cast(Panel, figure.add_subplot(cell))


def add_colorbar(figure: Figure, layer: ScalarMappable, panel: Panel, **look: object) -> Panel:
    """A colour bar beside `panel`; its own axes."""
    bar = cast(_Sheet, figure).colorbar(layer, ax=panel, **look)
    return cast(Panel, bar.ax)


def add_legend(figure: Figure, **look: object) -> None:
    """A legend of the whole figure."""
    cast(_Sheet, figure).legend(**look)


def add_title(figure: Figure, words: str, **look: object) -> None:
    """A title of the whole figure."""
    cast(_Sheet, figure).suptitle(words, **look)


def write(figure: Figure, path: Path, **look: object) -> None:
    """Write the figure in the format that the ending of `path` names."""
    cast(_Sheet, figure).savefig(path, **look)
