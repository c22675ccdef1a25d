"""The calibration plot: what predicted intervals contain, and the histogram of the PIT."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from planopt.channel.calibration import Calibration
from planopt.errors import InputError
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import BLACK, MARKERS, SERIES, dress, head, legend_below

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure


def draw_calibration(calibrations: Mapping[str, Calibration]) -> Figure:
    """Draw coverage against level with its 95 % interval, and the histogram of the PIT.

    Parameters
    ----------
    calibrations
        By the name of what predicted, for the legend.

    Raises
    ------
    InputError
        There is none.
    """
    from matplotlib.gridspec import GridSpec

    if not calibrations:
        raise InputError("there is no calibration to draw", key="calibrations")
    figure = new_figure(12.0, 5.4)
    cells = GridSpec(1, 2, figure=figure)
    coverage, pit = (add_panel(figure, cells[0, column]) for column in range(2))
    coverage.plot([0.0, 100.0], [0.0, 100.0], color=BLACK, linewidth=1.0, label="as promised")
    entries: list[Artist] = []
    for number, (name, calibration) in enumerate(calibrations.items()):
        entries.append(_draw_one(coverage, pit, name, calibration, number))
    even = 100.0 / len(next(iter(calibrations.values())).pit_share)
    uniform = pit.plot([0.0, 1.0], [even, even], color=BLACK, linewidth=1.0, label="as promised")
    coverage.set_xlim(40.0, 101.0)
    coverage.set_ylim(30.0, 101.0)
    pit.set_xlim(0.0, 1.0)
    pit.set_ylim(0.0, None)
    dress(coverage, "coverage", "level of the interval [%]", "measurements inside [%]")
    dress(
        pit,
        "probability integral transform",
        "predicted probability of less than measured [1]",
        "measurements [%]",
    )
    legend_below(figure, [*entries, *uniform], 4)
    count, censored = (
        _either(sorted({getattr(one, name) for one in calibrations.values()}))
        for name in ("count", "censored")
    )
    head(figure, f"calibration on {count} held-out measurements, {censored} censored")
    return figure


def _either(counts: list[int]) -> str:
    """A number, or from where to where where they differ."""
    return f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"


def _draw_one(
    coverage: Panel, pit: Panel, name: str, calibration: Calibration, number: int
) -> Artist:
    """Draw one calibration in both panels; the artist for the legend."""
    colour = SERIES[number % len(SERIES)]
    share = 100.0 * np.array([one.share for one in calibration.coverage])
    level = 100.0 * np.array([one.level for one in calibration.coverage])
    ends = 100.0 * np.array([(one.low, one.high) for one in calibration.coverage]).T
    # An end that equals the share may pass it by rounding.
    low, high = np.maximum(share - ends[0], 0.0), np.maximum(ends[1] - share, 0.0)
    coverage.errorbar(
        level,
        share,
        yerr=[low, high],
        ecolor=colour,
        elinewidth=1.4,
        capsize=3.0,
        linestyle="none",
    )
    (artist,) = coverage.plot(
        level,
        share,
        color=colour,
        marker=MARKERS[number % len(MARKERS)],
        markersize=5.0,
        linewidth=1.4,
        label=f"{name}: rmse {calibration.rmse_db:.2f} dB",
    )
    # The histogram as steps: several of them stay legible.
    pit.plot(
        np.repeat(calibration.pit_edges, 2)[1:-1],
        100.0 * np.repeat(calibration.pit_share, 2),
        color=colour,
        linewidth=1.6,
        label=name,
    )
    return artist
