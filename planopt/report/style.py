"""The style of every figure: colours for colour-blind readers as well, sizes, and words.

Colours are those of Okabe and Ito (2008) and the perceptually even maps viridis and cividis.
Nothing global is set: figures of the caller look as before.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

from planopt.report.panel import Panel, add_legend, add_title

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

BLACK, WHITE = "#000000", "#ffffff"
ORANGE, SKY, GREEN, YELLOW = "#e69f00", "#56b4e9", "#009e73", "#f0e442"
BLUE, VERMILLION, PURPLE = "#0072b2", "#d55e00", "#cc79a7"
SERIES = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")

OBSTACLE, OBSTACLE_EDGE, FRAME = "#efefef", "#8c8c8c", "#404040"
BAND = "#d9d9d9"
PREDICTED, TRUE, THRESHOLD = BLUE, BLACK, VERMILLION
CONNECTED, DISCONNECTED = SKY, VERMILLION

POWER_MAP, DEVIATION_MAP, PROBABILITY_MAP = "viridis", "cividis", "cividis"

TITLE_PT, LABEL_PT, TICK_PT, NOTE_PT = 11.0, 10.0, 9.0, 9.0

BAND_Z = 1.28
"""Half width of drawn bands in deviations: the middle 80 % of a normal distribution."""

BAND_WORDS = "80 % band"


def spaced(name: str) -> str:
    """A name as words."""
    return name.replace("_", " ")


def dress(panel: Panel, title: str, x_label: str, y_label: str, *, grid: bool = True) -> None:
    """Give a panel its title and labels, in the common sizes."""
    panel.set_title(title, fontsize=TITLE_PT, loc="left")
    panel.set_xlabel(x_label, fontsize=LABEL_PT)
    panel.set_ylabel(y_label, fontsize=LABEL_PT)
    panel.tick_params(labelsize=TICK_PT)
    if grid:
        panel.set_axisbelow(True)
        panel.grid(True, color="#e2e2e2", linewidth=0.6)


def frame_title(panel: Panel, words: str) -> Artist:
    """Title of one frame of an animation, as an artist that can be removed."""
    return panel.text(
        0.0, 1.01, words, transform=panel.transAxes, fontsize=TITLE_PT, va="bottom", zorder=9.0
    )


def head(figure: Figure, words: str) -> None:
    """Give a figure its title."""
    add_title(figure, words, fontsize=TITLE_PT + 1.0, fontweight="bold")


ROBOT_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, SKY, ORANGE)
ROBOT_MARKERS = ("o", "s", "D", "v", "P", "X", "h")
"""Of different lengths, so that the pair of colour and marker repeats late."""


def robot_colour(number: int) -> str:
    """Return the colour of a robot, the first has number 0."""
    return ROBOT_COLOURS[number % len(ROBOT_COLOURS)]


def robot_marker(number: int) -> str:
    """Return the marker of a robot."""
    return ROBOT_MARKERS[number % len(ROBOT_MARKERS)]


LETTER_IN, HANDLE_IN, LINE_IN = 0.068, 0.6, 0.19
"""Room in inches that a letter of a legend, the mark before its words, and a line of it take."""


def legend_below(figure: Figure, entries: Iterable[Artist], columns: int) -> None:
    """Legend under all panels, where it can cover no start and no goal.

    It has fewer columns than asked for where its words are long, and the figure grows as it does.
    """
    handles = list(entries)
    labels = [str(handle.get_label()) for handle in handles]
    longest = max((len(line) for label in labels for line in label.splitlines()), default=0)
    width_in, height_in = (float(side) for side in figure.get_size_inches())
    fitting = int(width_in / (LETTER_IN * longest + HANDLE_IN))
    fitting = max(1, min(columns, fitting))
    lines = math.ceil(len(labels) / fitting) - math.ceil(len(labels) / columns)
    figure.set_size_inches(width_in, height_in + LINE_IN * lines)
    add_legend(
        figure,
        handles=handles,
        labels=labels,
        loc="outside lower center",
        ncols=fitting,
        fontsize=NOTE_PT,
        frameon=False,
    )


def legend_above(panel: Panel, columns: int = 6) -> None:
    """Legend of curves, if any has a label, on the line of the panel's title."""
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


def plain_log_ticks(axis: Axis) -> None:
    """Write the values of a logarithmic axis out, at 1, 2 and 5."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def legend_inside(panel: Panel, place: str = "best") -> None:
    """Legend in a panel of dots, which leave room for it."""
    panel.legend(fontsize=NOTE_PT, loc=place, framealpha=0.9, edgecolor="none")
