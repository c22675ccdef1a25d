"""Proven bound on the objective of a problem, with its certificate."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.short_repr import short_repr

Sense = Literal["min", "max"]

GAP_TOLERANCE = 1e-6
"""Largest relative error of the cost that a bound is compared with; its outage is a quadrature."""


SEPARATION = "the separation of robots"  # Words for a constraint that a bound ignores
GIVEN_PLANS = "the bound of a robot holds only given the other robots' plans"
"""Reason why the robots' bounds do not add up."""


def relative_gap(cost: float, bound: float, sense: Sense) -> float:
    """Return the gap between a cost and its bound, relative to the cost; below 0 if violated."""
    better = cost - bound if sense == "min" else bound - cost
    return better / max(abs(cost), 1e-12)


@dataclass(frozen=True, eq=False)
class Potential:
    """Certificate of a bound: a function V that is quadratic on each triangle of a mesh."""

    nodes_m: Floats  # (n, 2); node 0 is the start
    corners: Indices  # (t, 3) ascending nodes of all triangles
    at_nodes: Floats  # (n,)
    at_sides: Floats  # (s,) at the middles of all sides, in ascending order of their nodes
    step_levels: int = 0  # Number of levels of cells around the first steps (equation 6.20)
    step_limit_m: float = 0.0  # Cost from which on these levels ignore plans


@dataclass(frozen=True, eq=False, kw_only=True)
class Design:
    """Measurements that relax an information objective (equation 9.13); none by default."""

    places_m: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    # (n, 2) measurements per place: in the reference, and in what is assumed to be known
    weights: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    # (2, 2) assumed information on the path loss, below each other for several parts
    path_loss: Floats = field(default_factory=lambda: np.zeros((2, 2)))


@dataclass(frozen=True, eq=False)
class Tilts(Design):
    """Certificate of a bound on a sum over N steps: the multipliers of branch and bound.

    Each part of the paths has a design of its own, whose arrays follow each other.
    """

    of_steps: Floats  # (t, N, 2) of the moves
    levels: int  # Number of levels of cells
    value: float  # Proven bound, given the other robots' plans
    alone_levels: int
    alone_value: float  # Proven bound without the other robots
    owner: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp), kw_only=True)
    # (c, 4) part that is cut, stage (from 0), axis and coordinate; the upper half is appended
    cuts: Floats = field(default_factory=lambda: np.zeros((0, 4)), kw_only=True)

    def designs(self) -> list[Design]:
        """Return the design of each part of the paths."""
        return [
            Design(
                places_m=self.places_m[self.owner == part],
                weights=self.weights[self.owner == part],
                path_loss=self.path_loss[2 * part : 2 * part + 2],
            )
            for part in range(len(self.cuts) + 1)
        ]


@dataclass(frozen=True)
class Bound:
    """Proven bound on the objective of one robot, or of all robots together.

    No verified plan of any planner has a better objective than `value`, which is a lower bound if
    the objective is minimised, else an upper bound. Plans count that satisfy p_min after the same
    steps as the released plan.

    Attributes
    ----------
    value
        Bound in the unit of the objective; None if none is proven.
    sense
        ``min`` for a lower bound of a minimised objective, ``max`` for an upper bound.
    cost
        Objective of the solution to compare with the bound. In tasks with a goal, outage is
        integrated along plan and route (equation 6.13).
    method
        Name of the method, with the size of its problem; None if there is no bound.
    reason
        Reason why there is no bound; empty if there is one.
    relaxed
        Constraints that the bound ignores. Ignoring them keeps the bound valid, but loosens it.
    alone
        Bound that holds whatever the other robots do; None if none is proven. It differs from
        `value` if robots with a sum of terms keep apart: `value` then holds given the other
        robots' plans.
    wall_s
        Wall time of the bound's computation, in seconds.
    certificate
        Data from which ``planopt check`` verifies the bound without a solver; None if not needed.

    Examples
    --------
    >>> import planopt
    >>> plan = planopt.solve(planopt.load("open_field"), prove_s=10.0).plan
    >>> plan.bound.value < plan.bound.cost  # gap about 1 %
    True
    """

    value: float | None
    sense: Sense
    cost: float
    method: str | None = None
    reason: str = ""
    relaxed: tuple[str, ...] = ()
    alone: float | None = None
    wall_s: float = 0.0
    certificate: Potential | Tilts | None = None

    __repr__ = short_repr

    @property
    def gap(self) -> float | None:
        """Return the signed gap relative to the cost; None without a bound.

        It is negative if the solution is better than its bound permits.
        """
        return None if self.value is None else relative_gap(self.cost, self.value, self.sense)


def total_bound(bounds: Sequence[Bound], sense: Sense) -> Bound:
    """Return the bound on the sum of objectives; its value is None if one robot has no bound."""
    cost = sum(bound.cost for bound in bounds)
    if len(bounds) == 1:
        return bounds[0]
    missing = [bound.reason or GIVEN_PLANS for bound in bounds if bound.alone is None]
    value = None if missing else sum(bound.alone or 0.0 for bound in bounds)
    relaxed = dict.fromkeys(words for bound in bounds for words in bound.relaxed)
    if any(bound.alone != bound.value for bound in bounds):
        relaxed[SEPARATION] = None
    side = "lower" if sense == "min" else "upper"
    return Bound(
        value,
        sense,
        cost,
        None if missing else f"sum of the robots' {side} bounds",
        missing[0] if missing else "",
        tuple(relaxed),
        value,
        sum(bound.wall_s for bound in bounds),
    )
