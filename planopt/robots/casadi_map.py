# pyright: basic
"""Any dynamics that CasADi can write: a discrete map, or a continuous one by Runge-Kutta.

From Python only: a problem file cannot hold a function. Of the way within a step nothing is known
but samples and the largest speed: between two samples that are d metres and t seconds apart the
robot is within sqrt((v t)^2 - d^2) / 2 of the straight line, in the ellipse of all ways that are
not too long; at equal times it is no farther from even motion on that line (Stewart's theorem). A
plan must end in a state in which the robot can rest.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.robots.carrot import Carrot
from planopt.robots.check_casadi_map import check_casadi_map
from planopt.robots.component_function import ComponentFunction
from planopt.robots.dynamics import Components, Disc
from planopt.robots.runge_kutta import runge_kutta
from planopt.world.ways import PointWay, StepWay

DENSER = 8
"""How many times as many samples a way is proven from as planned with."""

TRIED = 5
"""Values of each input that following a path looks at."""

HELD_STEPS = 2
"""For how many steps it looks ahead with each."""


@dataclass(frozen=True, eq=False)
class CasadiMap:
    """Dynamics given by a CasADi function.

    Attributes
    ----------
    function
        A ``casadi.Function`` of (state, input), both column vectors, to the next state, or to the
        derivative of the state where `continuous`.
    state_names, input_names
        Names with units. The first two states are the place in metres and must be called ``x_m``
        and ``y_m``.
    speed_max_m_s
        The robot is never faster: what is proven of its way rests on it.
    state_bounds, input_bounds
        Least and largest value of each component, infinite where there is no bound.
    rest_input
        The input with which it can stay where it is.
    continuous
        Whether `function` is a derivative.
    substeps
        Parts that a step is integrated in; 1 for a discrete map.
    """

    function: Any
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    speed_max_m_s: float
    state_bounds: tuple[tuple[float, float], ...]
    input_bounds: tuple[tuple[float, float], ...]
    rest_input: tuple[float, ...]
    continuous: bool = False
    substeps: int = 1
    _evaluated: ComponentFunction = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_casadi_map(self)
        object.__setattr__(self, "_evaluated", ComponentFunction(self.function))

    @property
    def kind(self) -> str:
        """What messages call it."""
        return "casadi_map"

    @property
    def discs(self) -> tuple[Disc, ...]:
        """None: all limits are intervals."""
        return ()

    def step(self, state: Components, control: Components, step_s: float) -> Components:
        """The state after a step."""
        return self._samples(state, control, step_s, self.substeps)[-1]

    def limits(self, control: Components, after: Components) -> Components:
        """Components over their finite bounds, scaled."""
        rows = []
        for values, bounds in ((control, self.input_bounds), (after, self.state_bounds)):
            for value, (low, high) in zip(values, bounds, strict=True):
                width = max(1.0, high - low) if math.isfinite(high - low) else 1.0
                rows += [(value - high) / width] if math.isfinite(high) else []
                rows += [(low - value) / width] if math.isfinite(low) else []
        return tuple(rows)

    def control_points(
        self, state: Components, control: Components, step_s: float
    ) -> tuple[tuple[Any, Any], ...]:
        """Places between the parts of a step."""
        samples = self._samples(state, control, step_s, self.substeps)
        return tuple((sample[0], sample[1]) for sample in samples[:-1])

    def way_pad_m(self, step_s: float) -> float:
        """Half of what it drives in a part of a step at most."""
        return 0.5 * self.speed_max_m_s * step_s / self.substeps

    def timed_pad_m(self, step_s: float) -> float:
        """None: that far it may be from even motion between the places, too."""
        return 0.0

    def stop_points(self, state: Components, step_s: float) -> tuple[tuple[Any, Any], ...]:
        """None: a plan ends at rest."""
        return ()

    def stop_way(self, state: NDArray[np.float64], step_s: float) -> None:
        """None."""

    def stop_rows(self, state: Components, step_s: float) -> Components:
        """What the rest input changes."""
        after = self.step(state, self.rest_input, step_s)
        return tuple(there - here for there, here in zip(after, state, strict=True))

    def stop_steps(self, state: NDArray[np.float64], step_s: float) -> int:
        """None: a plan ends at rest."""
        return 0

    def longest_stop_steps(self, step_s: float) -> int:
        """None."""
        return 0

    def resting_place(self, state: Components) -> tuple[Any, Any]:
        """Where it is: nothing is known of how it brakes, and a plan ends at rest."""
        return state[0], state[1]

    def turning_s(self, state: Components, place: tuple[Any, Any]) -> Any:
        """Nothing is known of how it turns."""
        return 0.0

    def braking(self, state: NDArray[np.float64], step_s: float, steps: int) -> NDArray[np.float64]:
        """The rest input."""
        return np.tile(np.array(self.rest_input), (steps, 1))

    def following(
        self, state: NDArray[np.float64], path_m: NDArray[np.float64], step_s: float
    ) -> NDArray[np.float64]:
        """Of some inputs, each held for two steps, the one that leads nearest to the path ahead."""
        carrot = Carrot(np.vstack([state[:2], path_m]))
        ranges = [
            np.linspace(max(low, rest - 1.0), min(high, rest + 1.0), TRIED)
            if not (math.isfinite(low) and math.isfinite(high))
            else np.linspace(low, high, TRIED)
            for (low, high), rest in zip(self.input_bounds, self.rest_input, strict=True)
        ]
        tried = np.array([self.rest_input, *itertools.product(*ranges)])
        inputs = np.zeros((len(path_m), len(self.input_names)))
        here = tuple(state)
        for k in range(len(path_m)):
            reach = HELD_STEPS * self.speed_max_m_s * step_s
            target, _ = carrot.ahead_m(np.array(here[:2], dtype=float), reach)
            after = tuple(np.full(len(tried), value) for value in here)
            for _ in range(HELD_STEPS):
                after = self.step(after, tuple(tried.T), step_s)
            away = np.hypot(after[0] - target[0], after[1] - target[1])
            inputs[k] = tried[int(np.argmin(away))]
            here = self.step(here, tuple(inputs[k]), step_s)
        return inputs

    def straight(
        self, state: NDArray[np.float64], end_m: NDArray[np.float64], step_s: float
    ) -> None:
        """None: nothing is known of how it moves."""

    def may_reach(
        self,
        state: NDArray[np.float64],
        places_m: NDArray[np.float64],
        duration_s: float,
        slack_m: float,
    ) -> NDArray[np.bool_]:
        """Nothing but the largest speed is known."""
        return np.ones(len(places_m), dtype=np.bool_)

    def ways(
        self, states: NDArray[np.float64], inputs: NDArray[np.float64], step_s: float
    ) -> list[StepWay]:
        """Samples of each step, and how far from the lines between them the robot can be."""
        count = self.substeps * DENSER if self.continuous else 1
        before, control = tuple(states.T), tuple(inputs.T)
        samples = [before, *self._samples(before, control, step_s, count)]
        places = np.array([[sample[0], sample[1]] for sample in samples]).transpose(2, 0, 1)
        end = np.column_stack(self.step(before, control, step_s)[:2])
        longest = self.speed_max_m_s * step_s / count
        found: list[StepWay] = []
        for way, planned in zip(places, end, strict=True):
            apart = np.linalg.norm(np.diff(way, axis=0), axis=1)
            within = 0.5 * math.sqrt(max(0.0, longest**2 - float(apart.min()) ** 2))
            # That the plan's integration is coarser counts as not knowing where the robot is.
            found.append(PointWay(way, within + float(np.linalg.norm(planned - way[-1]))))
        return found

    def excess_m(
        self, states: NDArray[np.float64], inputs: NDArray[np.float64], step_s: float
    ) -> float:
        """Of components over their bounds, and of steps longer than the speed allows."""
        unit = self.speed_max_m_s * step_s
        lengths = np.linalg.norm(np.diff(states[:, :2], axis=0), axis=1)
        over = [float(np.max(lengths, initial=0.0)) - unit]
        for table, bounds in ((inputs, self.input_bounds), (states[1:], self.state_bounds)):
            for column, (low, high) in zip(table.T, bounds, strict=True):
                beyond = np.maximum(column - high, low - column)
                over.append(unit * float(np.max(beyond, initial=-np.inf)))
        return max(over)

    def unit_m(self, step_s: float) -> tuple[float, ...]:
        """Any other component counts as what is driven in a step at most."""
        other = self.speed_max_m_s * step_s
        return (1.0, 1.0, *(other for _ in self.state_names[2:]))

    def _samples(
        self, state: Components, control: Components, step_s: float, count: int
    ) -> list[Components]:
        if self.continuous:
            return runge_kutta(self._evaluated, state, control, step_s, count)
        return [self._evaluated(state, control)]
