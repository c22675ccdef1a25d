"""The sensitivity of a map to parameters: mean Delta^2 by the error in each (equation 1.16)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.report.panel import add_panel, new_figure
from planopt.report.style import MARKERS, SERIES, dress, head, legend_below

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

NAMES = {
    "k_pl_db": "path loss at 1 m, K_PL",
    "n_pl": "path loss exponent, n_PL",
    "shadow_variance_db2": "shadowing variance, ξ²",
    "decorrelation_m": "decorrelation distance, β",
    "multipath_std_db": "multipath deviation, ω",
}


def draw_sensitivity(
    relative_errors: Sequence[float], curves: Mapping[str, NDArray[np.float64]]
) -> Figure:
    """Draw the average of Delta^2 [dB^2] against the error [%], a curve a parameter.

    Parameters
    ----------
    relative_errors
        ``(k,)`` shares.
    curves
        From :func:`planopt.channel.sensitivity.sensitivity_curves`, or averages of several.

    Raises
    ------
    InputError
        A curve has another length than the errors, or there is none.
    """
    from matplotlib.gridspec import GridSpec

    if not curves or any(len(curve) != len(relative_errors) for curve in curves.values()):
        raise InputError(
            f"there is not one value for each of {len(relative_errors)} errors",
            key="curves",
            remedy="give what sensitivity_curves returned for these errors",
        )
    percent = 100.0 * np.asarray(relative_errors, dtype=np.float64)
    figure = new_figure(8.0, 5.4)
    panel = add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])
    entries: list[Artist] = []
    for number, (name, curve) in enumerate(curves.items()):
        entries += panel.plot(
            percent,
            curve,
            color=SERIES[number % len(SERIES)],
            marker=MARKERS[number % len(MARKERS)],
            markersize=5.0,
            linewidth=1.8,
            label=NAMES.get(name, name),
        )
    panel.set_ylim(0.0, None)
    dress(panel, "", "error in one parameter [%]", "mean squared error Δ² [dB²]")
    legend_below(figure, entries, 2)
    head(figure, "what an error in one parameter does to the predicted map")
    return figure
