"""Figures and panels: layout, files, and the common style of all figures, without pyplot."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from planopt.arrays import Floats
from planopt.errors import InputError
from planopt.files.writing import write_whole

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

# Matplotlib's cached list of fonts may lack its own fonts for symbols, which are not used.
logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)

BLACK, WHITE = "#000000", "#ffffff"
ORANGE, SKY, GREEN, YELLOW = "#e69f00", "#56b4e9", "#009e73", "#f0e442"
BLUE, VERMILLION, PURPLE = "#0072b2", "#d55e00", "#cc79a7"
SERIES = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES = ("-", "--", "-.", ":")

OBSTACLE, OBSTACLE_EDGE, FRAME = "#efefef", "#8c8c8c", "#404040"
BAND = "#d9d9d9"
NOTE_BOX = {"boxstyle": "round,pad=0.15", "facecolor": WHITE, "edgecolor": "none", "alpha": 0.8}
PREDICTED, TRUE, THRESHOLD = BLUE, BLACK, VERMILLION
CONNECTED, DISCONNECTED = SKY, VERMILLION

POWER_MAP, DEVIATION_MAP, PROBABILITY_MAP = "viridis", "cividis", "cividis"

TITLE_PT, LABEL_PT, TICK_PT, NOTE_PT = 11.0, 10.0, 9.0, 9.0

BAND_Z = 1.28
"""Half width of bands in standard deviations: the central 80 % of a normal distribution."""

BAND_WORDS = "80 % band"

ROBOT_MARKERS = ("o", "s", "D", "v", "P", "X", "h")
"""Markers of robots; their number differs from that of colours, so that pairs repeat late."""
TIME = "time [s]"
LETTER_IN, HANDLE_IN, LINE_IN = 0.068, 0.6, 0.19
"""Widths of a legend's character and handle and height of a line, in inches."""
DPI = 110  # Resolution of pixel formats in dpi
UNDATED: dict[str, dict[str, None]] = {
    ".png": {},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}
"""File formats, with metadata that suppress the date."""

Values = Floats | Sequence[float]
Look = dict[str, Any]
"""Keyword arguments of Matplotlib that define a style."""


MIN_MAP_IN, BESIDE_IN, ABOVE_IN = 5.0, 1.7, 1.7
"""Minimum width of a map, and space for the colour bar and for titles and legend, in inches."""
Panel = Any
"""A ``matplotlib.axes.Axes``; it is untyped because Matplotlib's style keywords are."""


def new_figure(
    width_in: float,
    height_in: float,
    mosaic: Sequence[Sequence[object]] = ("A",),
    *,
    maps_only: bool = False,  # Panels of equal scale leave gaps, which are closed
    **ratios: Sequence[float],  # width_ratios, height_ratios of columns and rows
) -> tuple[Figure, list[Panel]]:
    """Return a figure and its panels; equal entries of the mosaic form one panel, "." is empty."""
    from matplotlib.figure import Figure

    layout = "compressed" if maps_only else "constrained"
    figure = Figure(figsize=(width_in, height_in), layout=layout)
    cells = [list(row) for row in mosaic]
    panels: dict[object, Panel] = cast("Any", figure).subplot_mosaic(cells, **ratios)
    names = dict.fromkeys(name for row in cells for name in row if name != ".")
    return figure, [panels[name] for name in names]


def fit_to_map(figure: Figure, panel: Panel, side_in: float) -> None:
    """Set a figure's size so that the longer side of its only panel is `side_in` inches long."""
    (left, right), (bottom, top) = panel.get_xlim(), panel.get_ylim()
    slender = (top - bottom) / (right - left)
    width_in = max(side_in * min(1.0, 1.0 / slender), MIN_MAP_IN)
    figure.set_size_inches(width_in + BESIDE_IN, side_in * min(1.0, slender) + ABOVE_IN)


def split_panel(figure: Figure, panel: Panel, shares: Sequence[float]) -> list[Panel]:
    """Replace a panel by stacked panels and return them; `shares` are their relative heights."""
    from matplotlib.gridspec import GridSpecFromSubplotSpec

    cell = panel.get_subplotspec()
    panel.remove()
    rows = GridSpecFromSubplotSpec(len(shares), 1, cell, height_ratios=shares)
    return [cast("Any", figure).add_subplot(rows[row, 0]) for row in range(len(shares))]


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure atomically.

    Parameters
    ----------
    figure
        Figure made by any of the ``draw_*`` functions.
    path
        File name ending in ``.png``, ``.svg`` or ``.pdf``; its folder is created if missing.

    Raises
    ------
    InputError
        The path has another suffix.
    OutputError
        The file cannot be written.
    """
    metadata = UNDATED.get(path.suffix.lower())
    if metadata is None:
        raise InputError(
            f"cannot write a figure to {path.name}: the ending {path.suffix!r} is not supported",
            remedy=f"use a name that ends in one of {', '.join(UNDATED)}",
        )
    write = cast("Any", figure).savefig
    write_whole(path, lambda temporary: write(temporary, dpi=DPI, metadata=metadata))


def colour_of(number: int) -> str:
    """Return the colour of a robot or series; numbers start at 0."""
    return SERIES[number % len(SERIES)]


def robot_marker(number: int) -> str:
    """Return the marker of a robot."""
    return ROBOT_MARKERS[number % len(ROBOT_MARKERS)]


def curve_look(number: int) -> dict[str, Any]:
    """Return colour, marker and sizes of a curve, by the curve's number."""
    return {
        "color": colour_of(number),
        "marker": MARKERS[number % len(MARKERS)],
        "markersize": 5.0,
        "linewidth": 1.6,
    }


def dashed_look(number: int) -> dict[str, Any]:
    """Return colour and dashes of a curve without markers, by the curve's number."""
    dashes = DASHES[number % len(DASHES)]
    return {"color": colour_of(number), "linestyle": dashes, "linewidth": 1.8}


def spaced(name: str) -> str:
    """Return a name with underscores replaced by spaces."""
    return name.replace("_", " ")


def dress(panel: Panel, title: str, x_label: str, y_label: str, *, grid: bool = True) -> None:
    """Set the title and labels of a panel, in the common font sizes."""
    panel.set_title(title, fontsize=TITLE_PT, loc="left")
    panel.set_xlabel(x_label, fontsize=LABEL_PT)
    panel.set_ylabel(y_label, fontsize=LABEL_PT)
    panel.tick_params(labelsize=TICK_PT)
    if grid:
        panel.set_axisbelow(True)
        panel.grid(True, color="#e2e2e2", linewidth=0.6)


def frame_title(panel: Panel, words: str) -> Artist:
    """Return the title of one animation frame, as an artist that can be removed."""
    return panel.text(
        0.0, 1.01, words, transform=panel.transAxes, fontsize=TITLE_PT, va="bottom", zorder=9.0
    )


def head(figure: Figure, words: str) -> None:
    """Set the title of a figure."""
    cast("Any", figure).suptitle(words, fontsize=TITLE_PT + 1.0, fontweight="bold")


def draw_intervals(
    panel: Panel, x: Values, y: Values, low: Values, high: Values, **look: Any
) -> Artist:
    """Draw markers (n,) with bars from `low` to `high` (no bar where NaN); return the markers."""
    # Rounding may put a bound on the wrong side of the value; NaN is kept.
    ends = (np.maximum(np.subtract(y, low), 0.0), np.maximum(np.subtract(high, y), 0.0))
    bars = {"elinewidth": 1.5, "capsize": 3.0, "linestyle": "none"}
    panel.errorbar(x, y, yerr=ends, ecolor=look["color"], **bars)
    (marks,) = panel.plot(x, y, **look)
    return marks


def draw_band(
    panel: Panel, x: Values, low: Values, high: Values, colour: str, label: str | None = None
) -> None:
    """Draw the area between two curves (n,)."""
    panel.fill_between(x, low, high, color=colour, alpha=0.16, linewidth=0.0, label=label)


def legend_below(figure: Figure, entries: Iterable[Artist], columns: int) -> None:
    """Add a legend below all panels, with fewer columns for long labels, and enlarge the figure."""
    handles: dict[str, Artist] = {}
    for entry in entries:
        handles.setdefault(str(entry.get_label()), entry)
    labels = list(handles)
    longest = max((len(line) for label in labels for line in label.splitlines()), default=0)
    width_in, height_in = (float(side) for side in figure.get_size_inches())
    fitting = int(width_in / (LETTER_IN * longest + HANDLE_IN))
    fitting = max(1, min(columns, fitting))
    lines = math.ceil(len(labels) / fitting) - math.ceil(len(labels) / columns)
    figure.set_size_inches(width_in, height_in + LINE_IN * lines)
    cast("Any", figure).legend(
        handles=list(handles.values()),
        labels=labels,
        loc="outside lower center",
        ncols=fitting,
        fontsize=NOTE_PT,
        frameon=False,
    )


def legend_above(panel: Panel, columns: int = 6) -> None:
    """Add a legend of labelled curves, if any, on the line of the panel's title."""
    if not panel.get_legend_handles_labels()[1]:
        return
    panel.legend(
        fontsize=NOTE_PT,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=columns,
        frameon=False,
        borderaxespad=0.0,
        columnspacing=1.2,
    )


def legend_inside(panel: Panel, place: str = "best") -> None:
    """Add a legend inside a panel whose dots are sparse."""
    panel.legend(fontsize=NOTE_PT, loc=place, framealpha=0.9, edgecolor="none")


def log_scale(panel: Panel, *names: str) -> None:
    """Make the axes named "x" or "y" logarithmic, with plain numbers at 1, 2 and 5."""
    for name in names:
        getattr(panel, f"set_{name}scale")("log")
        plain_log_ticks(getattr(panel, f"{name}axis"))


def plain_log_ticks(axis: Axis) -> None:
    """Label a logarithmic axis with plain numbers at 1, 2 and 5."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())
