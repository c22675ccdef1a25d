"""Profiles of the likelihood: which values of a parameter the measurements do not rule out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.estimation.profile import CUT_95, WORDS, Profile, interval_words
from planopt.report.panel import Panel
from planopt.report.style import BLACK, PREDICTED, VERMILLION, dress, plain_log_ticks

if TYPE_CHECKING:
    from matplotlib.artist import Artist

LEAST_SHOWN = -4.4
"""Lowest log likelihood that is shown, less the largest."""

CURVE_POINTS = 300

SHORT = {
    "shadow_std_db": "shadowing",
    "decorrelation_m": "decorrelation",
    "multipath_std_db": "multipath",
}


def draw_profiles(
    panels: Sequence[Panel], profiles: Sequence[Profile], fit: ChannelFit
) -> list[Artist]:
    """Draw each profile with the 95 % cut, the set of values above it, and the fit's estimate.

    Returns
    -------
    list[Artist]
        For a legend of all panels.
    """
    entries: list[Artist] = []
    for number, (panel, profile) in enumerate(zip(panels, profiles, strict=True)):
        name, (long_name, unit) = SHORT[profile.parameter], WORDS[profile.parameter]
        entries = _draw_profile(panel, profile, getattr(fit.parameters, profile.parameter), fit)
        label = "log likelihood less its largest [1]" if number == 0 else ""
        known = interval_words(*profile.interval_95(), unit)
        dress(panel, f"{name}: {known}", f"{long_name} [{unit}]", label)
        panel.set_xscale("log")
        plain_log_ticks(panel.xaxis)
        panel.set_ylim(LEAST_SHOWN, 0.35)
    return entries


def _draw_profile(panel: Panel, profile: Profile, estimate: float, fit: ChannelFit) -> list[Artist]:
    """Draw the curve, what of it is above the cut, and the estimate."""
    values, drop = profile.curve(CURVE_POINTS)
    low, high = profile.interval_95()
    inside = (values >= low) & (values <= high)
    (curve,) = panel.plot(
        values, drop, color=PREDICTED, linewidth=2.0, label="profile of the restricted likelihood"
    )
    (line,) = panel.plot(
        [estimate, estimate],
        [LEAST_SHOWN, 0.0],
        color=BLACK,
        linewidth=1.4,
        linestyle=":",
        label=f"estimate of {fit.method}",
    )
    return [
        curve,
        panel.axhline(
            -CUT_95, color=VERMILLION, linewidth=1.2, linestyle="--", label="95 % cut (chi-square)"
        ),
        panel.fill_between(
            values[inside],
            drop[inside],
            LEAST_SHOWN,
            color=PREDICTED,
            alpha=0.15,
            linewidth=0.0,
            label="95 % confidence set",
        ),
        line,
    ]
