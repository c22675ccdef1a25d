"""The reliability diagram: predicted against true connection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from planopt.channel.calibration import EDGES, ReliabilityBin
from planopt.errors import InputError
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import BLACK, MARKERS, SERIES, dress, head, legend_below

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

WIDTH = 0.6
"""Room that the series share in a bin of the second panel."""


def draw_reliability(series: Mapping[str, Sequence[ReliabilityBin]], title: str) -> Figure:
    """Draw true against predicted connection, and by how much they differ in each bin.

    Bars are 95 % intervals over groups, where there are enough groups; below each bin stands how
    many predictions of the first series it holds.
    """
    from matplotlib.gridspec import GridSpec

    edges = sorted({(one.low, one.high) for bins in series.values() for one in bins})
    if not edges:
        raise InputError("there is no prediction to draw", key="reliability")
    figure = new_figure(13.0, 5.4)
    cells = GridSpec(1, 2, figure=figure, width_ratios=[1.0, 1.5])
    diagram, difference = (add_panel(figure, cells[0, column]) for column in range(2))
    diagonal = diagram.plot(
        [0.0, 100.0], [0.0, 100.0], color=BLACK, linewidth=1.0, label="as predicted"
    )
    difference.axhline(0.0, color=BLACK, linewidth=1.0)
    entries: list[Artist] = list(diagonal)
    for number, (name, bins) in enumerate(series.items()):
        at = np.array([edges.index((one.low, one.high)) for one in bins], dtype=np.float64)
        shift = WIDTH * ((number + 0.5) / len(series) - 0.5)
        entries.append(_draw_one(diagram, difference, name, bins, at + shift, number))
    counts = {(one.low, one.high): one.count for one in next(iter(series.values()))}
    difference.set_xticks(
        np.arange(len(edges), dtype=np.float64),
        labels=[
            f"{100 * low:g}-{100 * high:g}\nn={counts.get((low, high), 0)}" for low, high in edges
        ],
    )
    difference.set_xlim(-0.6, len(edges) - 0.4)
    least = 100.0 * min(low for low, _ in edges)
    diagram.set_xlim(min(least, 100.0 * EDGES[-2]) - 1.0, 101.0)
    dress(diagram, "reliability", "predicted P(connected) [%]", "truly connected [%]")
    dress(
        difference,
        "truly connected less predicted",
        "bin of predicted P(connected) [%]",
        "difference [percentage points]",
    )
    legend_below(figure, entries, 4)
    head(figure, title)
    return figure


def _draw_one(
    diagram: Panel,
    difference: Panel,
    name: str,
    bins: Sequence[ReliabilityBin],
    at: np.ndarray[tuple[int], np.dtype[np.float64]],
    number: int,
) -> Artist:
    """Draw one series in both panels, at `at` (b,) in the second; the artist for the legend."""
    predicted = 100.0 * np.array([one.predicted for one in bins])
    realised = 100.0 * np.array([one.realised for one in bins])
    ends = 100.0 * np.array([one.interval or (np.nan, np.nan) for one in bins])
    # An end that equals the share may pass it by rounding; NaN stays.
    bars = [np.maximum(realised - ends[:, 0], 0.0), np.maximum(ends[:, 1] - realised, 0.0)]
    look = {
        "color": SERIES[number % len(SERIES)],
        "marker": MARKERS[number % len(MARKERS)],
        "markersize": 5.0,
        "linewidth": 1.4,
    }
    for panel, x, y in ((diagram, predicted, realised), (difference, at, realised - predicted)):
        panel.errorbar(
            x, y, yerr=bars, ecolor=look["color"], elinewidth=1.4, capsize=3.0, linestyle="none"
        )
    difference.plot(at, realised - predicted, **{**look, "linestyle": "none"})
    (artist,) = diagram.plot(predicted, realised, label=name, **look)
    return artist
