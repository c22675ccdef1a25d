"""Evader behaviour: at rest, random walk, or flight from pursuers, greedy or with planning.

Evaders know their pursuers' exact positions and target points, so they are stronger adversaries
than real ones.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from planopt.arrays import Floats
from planopt.keys import SMALLEST, Table
from planopt.pursuit.arena import Arena

HEADINGS = 32  # Number of candidate directions; the first points straight away from a pursuer


@dataclass(frozen=True, eq=False)
class EvaderView:
    """Information available to an evader's decision."""

    place_m: Floats  # (2,)
    speed_m_s: float  # Maximum speed of the evader
    pursuers_m: Floats  # (p, 2)
    aims_m: Floats  # (p, 2) points that the pursuers drive towards
    pursuer_speed_m_s: float  # Speed of the fastest pursuer
    step_s: float  # Time until the next decision
    arena: Arena


Decide = Callable[[EvaderView], Floats]
"""Function that returns the position (2,) after one step."""


class Static(Table):
    """An evader at rest."""

    kind: Literal["static"] = "static"

    def begin(self, generator: np.random.Generator) -> Decide:
        """Return a decision function that keeps the position."""
        return lambda view: view.place_m


class Wandering(Table):
    """An evader at full speed with a random walk of its heading."""

    kind: Literal["wandering"] = "wandering"
    turn_std_rad: float = Field(default=0.3, ge=0, le=100)
    """Standard deviation of the heading change within a second, in rad."""

    def begin(self, generator: np.random.Generator) -> Decide:
        """Return a random-walk decision function that replaces blocked headings by free ones."""
        heading = generator.uniform(0.0, 2.0 * np.pi)

        def decide(view: EvaderView) -> Floats:
            nonlocal heading
            heading += generator.normal(0.0, self.turn_std_rad) * np.sqrt(view.step_s)
            turns = heading + _fan()
            ends_m = view.arena.moved(view.place_m, view.speed_m_s * view.step_s * _unit(turns))
            whole_m = 0.999 * view.speed_m_s * view.step_s
            free = np.linalg.norm(ends_m - view.place_m, axis=1) >= whole_m
            chosen = int(free.argmax())
            heading = float(turns[chosen])
            return ends_m[chosen]

        return decide


class Fleeing(Table):
    """An evader that greedily maximises its distance from the nearest pursuer, around obstacles."""

    kind: Literal["fleeing"] = "fleeing"
    from_aims: bool = False
    """Flag for fleeing from the pursuers' aims instead of their positions."""

    def begin(self, generator: np.random.Generator) -> Decide:
        """Return the greedy decision function."""

        def decide(view: EvaderView) -> Floats:
            feared_m = view.aims_m if self.from_aims else view.pursuers_m
            nearest = feared_m[np.linalg.norm(feared_m - view.place_m, axis=1).argmin()]
            turns = _away_rad(view.place_m, nearest) + _fan()
            ends_m = view.arena.moved(view.place_m, view.speed_m_s * view.step_s * _unit(turns))
            left_m = [view.arena.distances_m(each, ends_m) for each in feared_m]
            return ends_m[int(np.min(left_m, axis=0).argmax())]

        return decide


class Zigzag(Table):
    """An evader that flees from its pursuers' target points in a zigzag."""

    kind: Literal["zigzag"] = "zigzag"
    period_s: float = Field(ge=SMALLEST, le=1e6)
    """Time between turns, in seconds."""
    angle_rad: float = Field(default=1.0, ge=0, le=math.pi)
    """Deviation to either side, in rad."""

    def begin(self, generator: np.random.Generator) -> Decide:
        """Return the zigzag decision function, with a random initial phase."""
        clock_s = generator.uniform(0.0, 2.0 * self.period_s)

        def decide(view: EvaderView) -> Floats:
            nonlocal clock_s
            clock_s += view.step_s
            side = 1.0 if clock_s % (2.0 * self.period_s) < self.period_s else -1.0
            feared_m = view.aims_m[np.linalg.norm(view.aims_m - view.place_m, axis=1).argmin()]
            turn = _away_rad(view.place_m, feared_m) + side * self.angle_rad
            move_m = view.speed_m_s * view.step_s * _unit(np.array([turn]))
            return view.arena.moved(view.place_m, move_m)[0]

        return decide


class Foresighted(Table):
    """An evader that plans two legs to maximise its distance from pursuers that chase directly."""

    # Obstacles block the first step of a plan; the rest of it ignores them.

    kind: Literal["foresighted"] = "foresighted"
    horizon: int = Field(ge=1, le=100)
    """Planning horizon in plan steps."""
    plan_step_s: float = Field(ge=SMALLEST, le=1e4)
    """Duration of a plan step in seconds."""

    def begin(self, generator: np.random.Generator) -> Decide:
        """Return a decision function that executes the first step of a new plan each time."""

        def decide(view: EvaderView) -> Floats:
            nearest = np.linalg.norm(view.pursuers_m - view.place_m, axis=1).argmin()
            headings = _away_rad(view.place_m, view.pursuers_m[nearest]) + _fan()[::2]
            first, then = (_unit(each.ravel()) for each in np.meshgrid(headings, headings))
            score = self._score_m(view, first, then)
            move_m = view.speed_m_s * view.step_s * first
            ends_m = view.arena.moved(view.place_m, move_m)
            if view.arena.obstacles is not None:
                score[(ends_m == view.place_m).all(axis=1)] = -np.inf
            return ends_m[int(score.argmax())]

        return decide

    def _score_m(self, view: EvaderView, first: Floats, then: Floats) -> Floats:
        """Return each plan's score: mainly the final distance from the nearest pursuer."""
        places = np.tile(view.place_m, (len(first), 1))
        hunters = np.tile(view.pursuers_m[:, None], (1, len(first), 1))
        step_m = view.speed_m_s * self.plan_step_s
        chase_m = view.pursuer_speed_m_s * self.plan_step_s
        total_m = np.zeros(len(first))
        for number in range(self.horizon):
            leg = first if 2 * number < self.horizon else then
            places = view.arena.within(places + step_m * leg)
            offset = places - hunters
            away_m = np.linalg.norm(offset, axis=-1, keepdims=True)
            hunters = hunters + offset * np.minimum(1.0, chase_m / np.maximum(away_m, 1e-12))
            left_m = np.linalg.norm(places - hunters, axis=-1).min(axis=0)
            # Small weights on earlier distances make late capture preferable to early capture.
            total_m += left_m * (1.0 if number + 1 == self.horizon else 0.1)
        return total_m


Behaviour = Static | Wandering | Fleeing | Zigzag | Foresighted
"""Behaviour of an evader; `begin` returns its decisions for one pursuit, with their own memory."""


def _fan() -> Floats:
    """Return candidate turns in rad: zero, then alternating sides with increasing angle."""
    turns = np.arange(1, HEADINGS // 2 + 1) * (2.0 * np.pi / HEADINGS)
    return np.append(0.0, np.stack([turns, -turns], axis=1).ravel()[:-1])


def _unit(headings_rad: Floats) -> Floats:
    return np.stack([np.cos(headings_rad), np.sin(headings_rad)], axis=-1)


def _away_rad(place_m: Floats, feared_m: Floats) -> float:
    offset = place_m - feared_m
    return float(np.arctan2(offset[1], offset[0]))
