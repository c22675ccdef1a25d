"""The rest of the way to a goal beyond a plan, with the coverage holes that it crosses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.planning.holes import Hole
from planopt.planning.plan import Plan
from planopt.report.maps import PATH_Z
from planopt.report.panel import Panel
from planopt.report.style import BLACK, VERMILLION, WHITE

if TYPE_CHECKING:
    from matplotlib.artist import Artist


def draw_route(panel: Panel, plan: Plan) -> list[Artist]:
    """Draw the way on from a plan's last place, and all holes; nothing of a plan without."""
    artists: list[Artist] = []
    if len(plan.route_m):
        way = np.vstack([plan.positions_m[-1:], plan.route_m])
        artists += panel.plot(
            *way.T,
            color=BLACK,
            linewidth=1.2,
            linestyle=(0, (1, 2)),
            zorder=PATH_Z - 0.2,
            label="the way on to the goal",
        )
    places = np.vstack([plan.positions_m, plan.route_m])
    for number, hole in enumerate(plan.holes):
        x, y = _places_of(places, hole).T
        panel.plot(x, y, color=WHITE, linewidth=7.0, zorder=PATH_Z - 0.4, solid_capstyle="butt")
        (line,) = panel.plot(
            x,
            y,
            color=VERMILLION,
            linewidth=5.0,
            zorder=PATH_Z - 0.3,
            solid_capstyle="butt",
            label="crosses a coverage hole",
        )
        if number == 0:
            artists.append(line)
        middle = len(x) // 2
        panel.text(
            x[middle],
            y[middle],
            f"{hole.length_m:.0f} m",
            zorder=PATH_Z + 0.5,
            clip_on=True,
            bbox={"boxstyle": "round,pad=0.15", "fc": WHITE, "ec": "none", "alpha": 0.8},
        )
    return artists


def _places_of(places_m: NDArray[np.float64], hole: Hole) -> NDArray[np.float64]:
    """Places (n, 2) of a path from half a step before a hole to half a step behind it."""
    first = int(np.argmin(np.linalg.norm(places_m - np.array(hole.from_m), axis=1)))
    last = int(np.argmin(np.linalg.norm(places_m - np.array(hole.to_m), axis=1)))
    first, last = min(first, last), max(first, last)
    inside = places_m[first : last + 1]
    before = 0.5 * (places_m[max(first - 1, 0)] + places_m[first])
    behind = 0.5 * (places_m[min(last + 1, len(places_m) - 1)] + places_m[last])
    return np.vstack([before, inside, behind])
