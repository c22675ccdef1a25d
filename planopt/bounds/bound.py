"""Proven bound on the objective of a problem, with its certificate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class Potential:
    """Certificate of a bound: a function V that is quadratic on each triangle of a mesh."""

    nodes_m: NDArray[np.float64]  # (n, 2); node 0 is the start
    corners: NDArray[np.intp]  # (t, 3) ascending nodes of all triangles
    at_nodes: NDArray[np.float64]  # (n,)
    at_sides: NDArray[
        np.float64
    ]  # (s,) at the middles of all sides, in ascending order of their nodes


@dataclass(frozen=True, eq=False)
class Tilts:
    """Certificate of a bound on a sum over N steps: the multipliers of branch and bound."""

    of_steps: NDArray[np.float64]  # (t, N, 2) of the moves
    of_p_min: NDArray[np.float64]  # (t, N) of the chance constraint, at least 0
    levels: int  # Number of levels of cells
    value: float  # Proven bound


@dataclass(frozen=True)
class Bound:
    """Proven bound on the objective of one robot, or of all robots together.

    No plan of any planner has a better objective than `value`, which is a lower bound if the
    objective is minimised, else an upper bound.

    Attributes
    ----------
    value
        Bound in the unit of the objective; None if none is proven.
    cost
        Objective of the solution to compare with the bound. In tasks with a goal, outage is
        integrated along plan and route (equation 6.13).
    method
        Name of the method, with the size of its problem; None if there is no bound.
    reason
        Reason why there is no bound; empty if there is one.
    relaxed
        Constraints that the bound ignores. Ignoring them keeps the bound valid, but loosens it.
    wall_s
        Wall time of the bound's computation, in seconds.
    certificate
        Data from which ``planopt check`` verifies the bound without a solver; None if not needed.

    Examples
    --------
    >>> import planopt
    >>> plan = planopt.solve(planopt.load("open_field"), prove_s=10.0).plan
    >>> plan.bound.value < plan.bound.cost  # gap about 2 %
    True
    """

    value: float | None
    cost: float
    method: str | None = None
    reason: str = ""
    relaxed: tuple[str, ...] = ()
    wall_s: float = 0.0
    certificate: Potential | Tilts | None = None

    __repr__ = short_repr

    @property
    def gap(self) -> float | None:
        """Return the relative gap ``|cost - value| / |cost|``; None without a bound."""
        if self.value is None:
            return None
        return 0.0 if self.cost == self.value else abs(self.cost - self.value) / abs(self.cost)


def total_bound(bounds: Sequence[Bound], sense: Literal["min", "max"]) -> Bound:
    """Return the bound on the sum of objectives; its value is None if one robot has no bound."""
    cost = sum(bound.cost for bound in bounds)
    if len(bounds) == 1:
        return bounds[0]
    missing = [bound.reason for bound in bounds if bound.value is None]
    value = None if missing else sum(bound.value or 0.0 for bound in bounds)
    methods = dict.fromkeys(bound.method for bound in bounds if bound.method)
    relaxed = dict.fromkeys(words for bound in bounds for words in bound.relaxed)
    side = "lower" if sense == "min" else "upper"
    return Bound(
        value,
        cost,
        None if missing else f"sum of the robots' {side} bounds: {'; '.join(methods)}",
        missing[0] if missing else "",
        tuple(relaxed),
        sum(bound.wall_s for bound in bounds),
    )
