"""How several robots are told apart: a colour and a marker each, the same in map and curves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planopt.problems.problem import Problem
from planopt.report.style import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION

if TYPE_CHECKING:
    from planopt.report.panel import Panel

ROBOT_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, SKY, ORANGE)
ROBOT_MARKERS = ("o", "s", "D", "v", "P", "X", "h")
"""Of different numbers, so that colour and marker together repeat late."""


def robot_colour(number: int) -> str:
    """Colour of robot number `number`, 0 is the first."""
    return ROBOT_COLOURS[number % len(ROBOT_COLOURS)]


def robot_marker(number: int) -> str:
    """Marker of robot number `number`."""
    return ROBOT_MARKERS[number % len(ROBOT_MARKERS)]


def name_rows(panel: Panel, problem: Problem) -> None:
    """Give every robot a row of a strip, the first on top."""
    count = len(problem.robots)
    panel.set_yticks([float(row) for row in range(count)], [r.name for r in problem.robots])
    panel.set_ylim(count - 0.4, -0.6)
