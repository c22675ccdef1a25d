"""How the settings of a comparison are told apart in its figure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planopt.report.style import MARKERS, SERIES
from planopt.studies.comparison import Comparison

SPREAD = 0.6
"""Width that the settings of one horizon share, in distances between horizons."""

Setting = tuple[str | None, str]
"""Cost to go, None where there is no goal, and planner."""


@dataclass(frozen=True)
class Look:
    """How one setting is drawn: shift and width are in distances between horizons."""

    label: str
    colour: str
    marker: str
    shift: float
    width: float


def looks_of(comparison: Comparison) -> dict[Setting, Look]:
    """Looks of the settings, in the order of the rows: colour by cost to go, marker by planner."""
    settings = list(dict.fromkeys((row.cost_to_go, row.planner) for row in comparison.rows))
    costs = list(dict.fromkeys(cost for cost, _ in settings))
    planners = list(dict.fromkeys(planner for _, planner in settings))
    shifts = SPREAD * ((np.arange(len(settings)) + 0.5) / len(settings) - 0.5)
    return {
        (cost, planner): Look(
            label=f"planner {planner}" if cost is None else f"{cost} cost to go, planner {planner}",
            colour=SERIES[costs.index(cost) % len(SERIES)],
            marker=MARKERS[planners.index(planner) % len(MARKERS)],
            shift=float(shift),
            width=SPREAD / len(settings),
        )
        for (cost, planner), shift in zip(settings, shifts, strict=True)
    }
