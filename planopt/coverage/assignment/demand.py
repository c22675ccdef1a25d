"""The number of agents, of n, that an event asks for.

A demand is any function from the number of agents to the number that should respond, between 0 and
the number of agents. The constructors here return such functions; :func:`demanded` checks what one
returns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from planopt.coverage.localisation.sensor import EventSensor, best_distance_m, sensitivity
from planopt.coverage.region import positive
from planopt.errors import InputError

Demand = Callable[[int], int]

HEXAGON = 5.0 / (18.0 * math.sqrt(3.0))
"""Second moment of a regular hexagon of area 1 about its centre."""

LEAST_ON_RING = 2
"""One agent alone measures a distance and no position."""


def demanded(demand: Demand, agents: int) -> int:
    """Return how many of `agents` agents an event asks for."""
    wanted = demand(agents)
    if wanted != int(wanted) or not 0 <= wanted <= agents:
        raise InputError(
            f"a demand of {wanted!r} among {agents} agents",
            key="demand",
            remedy="demands are whole numbers from 0 to the number of agents",
        )
    return int(wanted)


def table_demand(steps: Mapping[int, int]) -> Demand:
    """Return a demand that is looked up: the entry of the largest number not above n."""
    if not steps:
        raise InputError("the table is empty", key="demand")
    for number, wanted in steps.items():
        if not 0 <= wanted <= number:
            raise InputError(f"{wanted} of {number} agents", key=f"demand[{number}]")
    entries = sorted(steps.items(), reverse=True)

    def demand(agents: int) -> int:
        return next((wanted for number, wanted in entries if number <= agents), 0)

    return demand


def capped_demand(share: float, most: int, remaining: int) -> Demand:
    """Return a share of the agents, at most a number, and so that enough remain for coverage."""
    if not 0.0 <= share <= 1.0:
        raise InputError(f"{share!r} is not a share", key="demand.share")
    for key, value in (("most", most), ("remaining", remaining)):
        if value < 0:
            raise InputError(f"{value} is negative", key=f"demand.{key}")

    def demand(agents: int) -> int:
        # A share of 0.3 of 10 agents is 3, not the 4 that rounding up its last bit would give.
        asked = math.ceil(round(share * agents, 9))
        return max(min(agents - remaining, most, asked), 0)

    return demand


def accuracy_demand(
    sensor: EventSensor, accuracy_m: float, measurements: int = 1, radius_m: float | None = None
) -> Demand:
    """Return the least number of agents that locate an event well enough.

    Agents stand at equal angles on a ring (two of them 90 degrees apart), where the Cramer-Rao
    bound on the mean squared error is ``4 sigma^2 / (P m g^2)`` with g the sensor's slope there.
    """
    positive(accuracy_m, "demand.accuracy_m")
    if measurements < 1:
        raise InputError(f"{measurements} measurements", key="demand.measurements")
    radius = best_distance_m(sensor) if radius_m is None else positive(radius_m, "demand.radius_m")
    slope = sensitivity(sensor, radius)
    if not slope > 0.0:
        raise InputError(
            f"the signal does not change with distance at {radius:g} m", key="demand.radius_m"
        )
    exact = 4.0 * sensor.noise_std**2 / (measurements * slope**2 * accuracy_m**2)
    least = max(math.ceil(exact - 1e-9), LEAST_ON_RING)

    def demand(agents: int) -> int:
        return min(least, agents)

    return demand


def trade_off_demand(
    area_m2: float, localisation_m2: float, coverage_weight: float, localisation_weight: float
) -> Demand:
    """Return the number of agents that balances coverage against localisation.

    It minimises ``w_c c |A|^2 / (n - P) + w_s kappa / P`` over P, with c the second moment of a
    hexagon of area 1, by trying both whole numbers beside the minimum over the reals.
    """
    ahead = HEXAGON * positive(area_m2, "demand.area_m2") ** 2
    coverage = ahead * positive(coverage_weight, "demand.coverage_weight")
    localisation = positive(localisation_m2, "demand.localisation_m2") * positive(
        localisation_weight, "demand.localisation_weight"
    )

    def demand(agents: int) -> int:
        if agents < 2:
            return 0
        exact = agents / (1.0 + math.sqrt(coverage / localisation))
        low = min(max(math.floor(exact), 1), agents - 1)
        high = min(low + 1, agents - 1)
        return min(low, high, key=lambda p: coverage / (agents - p) + localisation / p)

    return demand
