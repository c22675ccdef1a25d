# pyright: basic
"""What is given of dynamics from Python fits together."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from planopt.errors import InputError

if TYPE_CHECKING:
    from planopt.robots.casadi_map import CasadiMap


def check_casadi_map(dynamics: CasadiMap) -> None:
    """Raise the first fault of its function, names, bounds and parts.

    Raises
    ------
    InputError
        With the attribute as its key.
    """
    states, inputs = len(dynamics.state_names), len(dynamics.input_names)
    sizes = [dynamics.function.size1_in(i) for i in range(dynamics.function.n_in())]
    if sizes != [states, inputs] or dynamics.function.size1_out(0) != states:
        raise InputError(
            f"takes {sizes} and gives {dynamics.function.size1_out(0)} numbers, should take "
            f"[{states}, {inputs}] and give {states}",
            key="function",
            remedy="one number for each of state_names and input_names",
        )
    if dynamics.state_names[:2] != ("x_m", "y_m"):
        raise InputError(
            f"begin with {', '.join(dynamics.state_names[:2])}, should begin with x_m, y_m",
            key="state_names",
            remedy="put the place first",
        )
    for key, bounds, count in (
        ("state_bounds", dynamics.state_bounds, states),
        ("input_bounds", dynamics.input_bounds, inputs),
    ):
        if len(bounds) != count or not all(low <= high for low, high in bounds):
            raise InputError(
                f"should be {count} pairs, the lower bound first", key=key, remedy="see names"
            )
    if len(dynamics.rest_input) != inputs:
        raise InputError(f"should be {inputs} numbers", key="rest_input", remedy="see names")
    if not (dynamics.speed_max_m_s > 0.0 and math.isfinite(dynamics.speed_max_m_s)):
        raise InputError("should be above 0", key="speed_max_m_s", remedy="a bound of speed")
    if dynamics.substeps < 1 or (dynamics.substeps > 1 and not dynamics.continuous):
        raise InputError(
            f"is {dynamics.substeps}, should be at least 1, and 1 of a discrete map",
            key="substeps",
            remedy="set continuous = True for a derivative",
        )
