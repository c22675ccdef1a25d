# pyright: basic
"""Dynamics defined by a CasADi function: a discrete map, or a derivative for Runge-Kutta.

Between two samples that are d metres and t seconds apart, all paths of speed at most v lie within
sqrt((v t)^2 - d^2) / 2 of the straight line, at equal times too (Stewart's theorem).
"""

import contextlib
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import least_squares

from planopt.arrays import Floats
from planopt.errors import InputError
from planopt.parts import make_plain
from planopt.robots.dynamics import Components, Dynamics, PurePursuit
from planopt.world.motion import PointCurve, StepCurve


class ComponentFunction:
    """CasADi function of (state, input) that accepts tuples of components."""

    def __init__(self, function: Any) -> None:
        self._function = function
        self._states = function.size1_in(0)
        self._results = function.size1_out(0)

    def __call__(self, state: Components, control: Components) -> Components:
        """Return the components of the result, with the type and shape of the arguments."""
        if any(isinstance(value, ca.SX | ca.MX) for value in (*state, *control)):
            return tuple(ca.vertsplit(self._function(ca.vertcat(*state), ca.vertcat(*control))))
        both = np.broadcast_arrays(*(np.asarray(value) for value in (*state, *control)))
        shape, table = both[0].shape, np.array([value.ravel() for value in both])
        if table.size == 0:  # CasADi treats an empty table as one column
            return tuple(np.zeros(shape, dtype=table.dtype) for _ in range(self._results))
        value = np.array(self._function(table[: self._states], table[self._states :]))
        return tuple(row.reshape(shape) for row in value)


Derivative = Callable[[Components, Components], Components]
"""Function that maps state and input to the time derivative of the state."""


def runge_kutta(
    derivative: Derivative, state: Components, control: Components, step_s: float, substeps: int
) -> list[Components]:
    """Return the states after each of `substeps` equal parts of a step with constant input."""
    part = step_s / substeps
    states: list[Components] = []
    for _ in range(substeps):
        first = derivative(state, control)
        second = derivative(_moved(state, first, 0.5 * part), control)
        third = derivative(_moved(state, second, 0.5 * part), control)
        fourth = derivative(_moved(state, third, part), control)
        slope: Any = tuple(
            (a + 2.0 * b + 2.0 * c + d) / 6.0
            for a, b, c, d in zip(first, second, third, fourth, strict=True)
        )
        state = _moved(state, slope, part)
        states.append(state)
    return states


def _moved(state: Components, slope: Components, duration_s: float) -> Components:
    return tuple(x + duration_s * dx for x, dx in zip(state, slope, strict=True))


DENSER = 8  # Ratio of the verifier's samples per step to the planner's
INPUT_VALUES = 5  # Number of values per input compared by :meth:`CasadiMap.following`
HELD_STEPS = 2  # Number of steps for which path following holds an input to compare it with others
REST_SEARCH = 1e-15
"""Tolerance of the search for a rest state, near rounding error because maps may be steep."""


@dataclass(frozen=True, eq=False)
class CasadiMap(Dynamics):
    """Dynamics defined by a CasADi function.

    Attributes
    ----------
    function
        ``casadi.Function`` from (state, input), both column vectors, to the next state, or to the
        derivative of the state if `continuous`.
    state_names, input_names
        Names with units. The first two states are the position and must be called ``x_m`` and
        ``y_m``.
    speed_max_m_s
        Largest speed, on which the verifier relies.
    state_bounds, input_bounds
        Minimum and maximum of each component; infinite if unbounded.
    rest_input
        Input that keeps the robot at rest.
    continuous
        Whether `function` is a derivative.
    substeps
        Runge-Kutta steps within a step; 1 for a discrete map.
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

    kind = "casadi_map"

    def __post_init__(self) -> None:
        make_plain(self)
        check_casadi_map(self)
        object.__setattr__(self, "_evaluated", ComponentFunction(self.function))

    def step(self, state: Components, control: Components, step_s: float) -> Components:
        """Return the state after a step."""
        return self._samples(state, control, step_s, self.substeps)[-1]

    def limits(self, control: Components, after: Components) -> Components:
        """Return the scaled excesses of states and inputs over their finite bounds."""
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
        """Return the positions between the substeps of a step."""
        samples = self._samples(state, control, step_s, self.substeps)
        return tuple((sample[0], sample[1]) for sample in samples[:-1])

    def hull_pad_m(self, step_s: float) -> float:
        """Return a bound on the distance from the hull: half the longest path of a substep."""
        return 0.5 * self.speed_max_m_s * step_s / self.substeps

    def stop_rows(self, state: Components, step_s: float) -> Components:
        """Return the change of the state in a step under the rest input."""
        after = self.step(state, self.rest_input, step_s)
        return tuple(there - here for there, here in zip(after, state, strict=True))

    def change_at_rest(self, state: Floats, step_s: float) -> Floats:
        """Return the smallest state change (s,) under the rest input at the position of `state`."""
        # Searches start from `state` and from zeros; a guess counts if the map is not finite.
        low, high = np.array(self.state_bounds)[2:].T
        free = low < high

        def change(rest: Floats) -> Floats:
            rows = np.array(self.stop_rows((*state[:2], *rest), step_s), dtype=np.float64)
            return np.where(np.isfinite(rows), rows, np.inf)

        def least(rest: Floats) -> Floats:
            def of_free(values: Floats) -> Floats:
                moved = rest.copy()
                moved[free] = values
                return change(moved)

            bounds, close = (low[free], high[free]), REST_SEARCH
            # SciPy rejects non-finite derivatives, which the map may have within the bounds.
            with np.errstate(all="ignore"), contextlib.suppress(ValueError):
                return of_free(
                    least_squares(
                        of_free, rest[free], bounds=bounds, ftol=close, xtol=close, gtol=close
                    ).x
                )
            return change(rest)

        found = []
        for begin in (state[2:], np.zeros(len(state) - 2)):
            rest = np.clip(begin, low, high)
            found.append(change(rest))
            if free.any() and np.isfinite(found[-1]).all() and found[-1].any():
                found.append(least(rest))
        return min(found, key=lambda rows: float(np.abs(rows).max()))

    def braking(self, state: Floats, step_s: float, steps: int) -> Floats:
        """Return the rest input for each step."""
        return np.tile(np.array(self.rest_input), (steps, 1))

    def following(self, state: Floats, path_m: Floats, step_s: float) -> Floats:
        """Return inputs that follow a path, found by comparing input values over two steps."""
        pursuit = PurePursuit(np.vstack([state[:2], path_m]))
        ranges = [
            np.linspace(max(low, rest - 1.0), min(high, rest + 1.0), INPUT_VALUES)
            if not (math.isfinite(low) and math.isfinite(high))
            else np.linspace(low, high, INPUT_VALUES)
            for (low, high), rest in zip(self.input_bounds, self.rest_input, strict=True)
        ]
        controls = np.array([self.rest_input, *itertools.product(*ranges)])
        inputs = np.zeros((len(path_m), len(self.input_names)))
        here = tuple(state)
        for k in range(len(path_m)):
            reach = HELD_STEPS * self.speed_max_m_s * step_s
            target, _ = pursuit.ahead_m(np.array(here[:2], dtype=float), reach)
            after = tuple(np.full(len(controls), value) for value in here)
            for _ in range(HELD_STEPS):
                after = self.step(after, tuple(controls.T), step_s)
            away = np.hypot(after[0] - target[0], after[1] - target[1])
            # The map may be undefined outside the state bounds.
            away = np.where(np.isnan(away), np.inf, away)
            inputs[k] = controls[int(np.argmin(away))]
            here = self.step(here, tuple(inputs[k]), step_s)
        return inputs

    def straight(self, state: Floats, end_m: Floats, step_s: float) -> None:
        """Return None, as a straight drive is unknown for a general map."""

    def curves(self, states: Floats, inputs: Floats, step_s: float) -> list[StepCurve]:
        """Return the path of each step as a polyline, with an error bound."""
        count = self.substeps * DENSER if self.continuous else 1
        before, control = tuple(states.T), tuple(inputs.T)
        samples = [before, *self._samples(before, control, step_s, count)]
        places = np.array([[sample[0], sample[1]] for sample in samples]).transpose(2, 0, 1)
        end = np.column_stack(self.step(before, control, step_s)[:2])
        longest = self.speed_max_m_s * step_s / count
        found: list[StepCurve] = []
        for points, planned in zip(places, end, strict=True):
            apart = np.linalg.norm(np.diff(points, axis=0), axis=1)
            within = 0.5 * math.sqrt(max(0.0, longest**2 - float(apart.min()) ** 2))
            # The plan's coarser integration error is added.
            error = float(np.linalg.norm(planned - points[-1]))
            found.append(PointCurve(points, within + error))
        return found

    def excess_m(self, states: Floats, inputs: Floats, step_s: float) -> float:
        """Return the largest excess in metres over component bounds and over the step length."""
        unit = self.speed_max_m_s * step_s
        lengths = np.linalg.norm(np.diff(states[:, :2], axis=0), axis=1)
        over = [float(np.max(lengths, initial=0.0)) - unit]
        for table, bounds in ((inputs, self.input_bounds), (states[1:], self.state_bounds)):
            for column, (low, high) in zip(table.T, bounds, strict=True):
                beyond = np.maximum(column - high, low - column)
                over.append(unit * float(np.max(beyond, initial=-np.inf)))
        return max(over)

    def unit_m(self, step_s: float) -> tuple[float, ...]:
        """Return the displacement in metres per unit of each component of the state."""
        other = self.speed_max_m_s * step_s
        return (1.0, 1.0, *(other for _ in self.state_names[2:]))

    def _samples(
        self, state: Components, control: Components, step_s: float, count: int
    ) -> list[Components]:
        if self.continuous:
            return runge_kutta(self._evaluated, state, control, step_s, count)
        return [self._evaluated(state, control)]


def check_casadi_map(dynamics: CasadiMap) -> None:
    """Raise an InputError for the first invalid attribute of the dynamics."""
    function: object = dynamics.function
    if not isinstance(function, ca.Function):
        raise InputError(
            f"is of type {type(function).__name__}, should be a casadi.Function",
            key="function",
            remedy="give casadi.Function(name, [state, input], [next_state]), where state and "
            "input are column vectors",
        )
    for key in ("state_names", "input_names"):
        names: object = getattr(dynamics, key)
        if not isinstance(names, tuple) or not all(isinstance(name, str) for name in names):
            raise InputError(
                f"is {names!r}, but must be a tuple of names",
                key=key,
                remedy='give one name for each component, such as ("x", "y")',
            )
    states, inputs = len(dynamics.state_names), len(dynamics.input_names)
    sizes = [function.size_in(i) for i in range(function.n_in())]
    gives = [function.size_out(i) for i in range(function.n_out())]
    if sizes != [(states, 1), (inputs, 1)] or gives != [(states, 1)]:
        raise InputError(
            f"has inputs of sizes {sizes} and outputs of sizes {gives}, should have "
            f"{[(states, 1), (inputs, 1)]} and {[(states, 1)]}",
            key="function",
            remedy="use column vectors with one number for each of state_names and input_names",
        )
    if dynamics.state_names[:2] != ("x_m", "y_m"):
        raise InputError(
            f"begins with {', '.join(dynamics.state_names[:2])}, should begin with x_m, y_m",
            key="state_names",
            remedy="put the position first",
        )
    for key, names, shape in (
        ("state_bounds", dynamics.state_names, (states, 2)),
        ("input_bounds", dynamics.input_names, (inputs, 2)),
        ("rest_input", dynamics.input_names, (inputs,)),
        ("speed_max_m_s", (), ()),
    ):
        given = getattr(dynamics, key)
        if not _are_numbers(given, shape):
            pairs = "a pair (least, largest)" if len(shape) == 2 else "a finite number"
            each = f" for each of {', '.join(names)}" if names else " above 0, e.g. 2.0"
            raise InputError(f"is invalid: {given!r}", key=key, remedy=f"give {pairs}{each}")
    if dynamics.speed_max_m_s <= 0.0:
        raise InputError(
            f"is {dynamics.speed_max_m_s!r}, should be above 0",
            key="speed_max_m_s",
            remedy="give the maximum speed in m/s, e.g. 2.0",
        )
    substeps: object = dynamics.substeps
    if not isinstance(substeps, int) or substeps < 1 or (substeps > 1 and not dynamics.continuous):
        raise InputError(
            f"is {substeps!r}, should be a whole number of at least 1, and 1 for a discrete map",
            key="substeps",
            remedy="set continuous = True if the function returns a derivative",
        )


def _are_numbers(given: Any, shape: tuple[int, ...]) -> bool:
    """Return whether values have `shape`, and are finite or ordered pairs of bounds."""
    try:
        found = np.array(given)
    except ValueError:
        return False
    if found.shape != shape or found.dtype.kind not in "iuf" or np.isnan(found).any():
        return False
    if len(shape) == 2:
        return bool((found[:, 0] <= found[:, 1]).all())
    return bool(np.isfinite(found).all())
