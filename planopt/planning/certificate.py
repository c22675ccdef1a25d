"""Findings on a plan: the certificate, the result of its rule, coverage holes, and their words."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, connection_probability
from planopt.errors import NoPlanError
from planopt.planning.tolerances import RULE_TOLERANCE, STANDSTILL_M, margins_asked_db
from planopt.problems.constraints import rule_kind
from planopt.problems.problem import Problem

MOST_IN_WORDS = 4
"""Of more holes the longest are told of."""

SHORTEST_IN_WORDS_M = 0.5
"""Shorter ones are rounded to nothing."""


@dataclass(frozen=True)
class Hole:
    """A stretch of a path that misses the bound on connectivity."""

    from_m: tuple[float, float]  # (x, y) of its first and last place below the bound
    to_m: tuple[float, float]
    length_m: float  # Driven below the bound, half of the steps in and out included
    least_connectivity: float  # Least probability of connection in it
    to_end: bool  # Whether the path ends in it

    @property
    def words(self) -> str:
        """Return where it is and how long."""
        x, y = self.from_m
        return (
            f"{self.length_m:.0f} m from ({x:.1f}, {y:.1f}) m on, "
            f"connected with probability {self.least_connectivity:.2f} at least"
        )


@dataclass(frozen=True, eq=False)
class BlockedWay:
    """The cheapest way of a robot to its goal, which a hard bound on connectivity forbids.

    Attributes
    ----------
    robot
        Whose way it would be.
    way_m
        ``(n, 2)`` places from where the robot is to the goal.
    holes
        Where it misses the bound, in its order.
    """

    robot: str
    way_m: NDArray[np.float64]
    holes: tuple[Hole, ...]


class BlockedError(NoPlanError):
    """There is no path to a goal that keeps a hard bound on connectivity.

    Parameters
    ----------
    message
        Where contact would have to be left, in words.
    blocked
        The ways on which it would be left least.
    """

    def __init__(self, message: str, blocked: tuple[BlockedWay, ...]) -> None:
        super().__init__(message)
        self.blocked = blocked


def holes_along(
    places_m: NDArray[np.float64],  # (n, 2) of the path
    connectivity: NDArray[np.float64],  # (n,) P(connected) there
    is_below: NDArray[np.bool_],  # (n,) whether that misses the bound
) -> tuple[Hole, ...]:
    """Find the holes of a path."""
    lengths = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
    share = 0.5 * (is_below[:-1].astype(float) + is_below[1:]) * lengths
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_below.astype(int), [0]])))
    holes: list[Hole] = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        begin, finish = places_m[first], places_m[end - 1]
        holes.append(
            Hole(
                (float(begin[0]), float(begin[1])),
                (float(finish[0]), float(finish[1])),
                float(share[max(first - 1, 0) : end].sum()),
                float(connectivity[first:end].min()),
                end == len(places_m),
            )
        )
    return tuple(holes)


def holes_on(
    problem: Problem, power: Prediction, places_m: NDArray[np.float64]
) -> tuple[Hole, ...]:
    """Find the holes of a path of places (n, 2), by what is believed."""
    threshold = problem.stations[0].threshold_dbm
    chance = connection_probability(power.mean_db, power.deviation_db, threshold)
    slack_db = problem.constraints.rule.slack_max_db or 0.0
    return holes_along(places_m, chance, margins_asked_db(problem, power) < -slack_db)


def holes_in_words(problem: Problem, holes: Sequence[Hole], verb: str = "crosses") -> list[str]:
    """Lines for people about holes on the way to a goal; the longest where there are many."""
    holes = [hole for hole in holes if hole.length_m >= SHORTEST_IN_WORDS_M]
    if not holes:
        return []
    price, p_min = problem.reach.outage_price, problem.constraints.p_min
    total_m = sum(hole.length_m for hole in holes)
    told = sorted(holes, key=lambda hole: -hole.length_m)[:MOST_IN_WORDS]
    lines = [f"{verb} a coverage hole of {hole.words}" for hole in holes if hole in told]
    if len(told) < len(holes):
        lines.append(f"{verb} {len(holes) - len(told)} shorter ones")
    lines.append(
        f"in all {total_m:.0f} m below constraints.p_min {p_min:g}, each metre at "
        f"objective.outage_price {price:g}"
    )
    return lines


def goal_in_words(problem: Problem, holes: Sequence[Hole]) -> list[str]:
    """A line for people where the goal itself is out of contact; none where it is not."""
    if not holes or not holes[-1].to_end:
        return []
    return [
        f"the goal {list(problem.goal_m)} is itself below constraints.p_min "
        f"{problem.constraints.p_min:g}, by what is measured so far"
    ]


@dataclass(frozen=True)
class RuleResult:
    """The value asked of a whole plan by its rule, and the value achieved.

    Attributes
    ----------
    connectivity
        The rule.
    achieved, asked
        Its value, and the bound: a least one, for ``outage`` a greatest one.
    unit
        ``probability``, ``m``, ``s``, ``Mbit`` or ``steps``.
    method
        How the value was found.
    slack_db
        By how many dB the threshold would have to be lower for the path to keep the rule, as far
        as slack is allowed; of single steps, the most.
    """

    connectivity: str
    achieved: float
    asked: float
    unit: str
    method: str
    slack_db: float = 0.0

    @property
    def missing(self) -> float:
        """Return by how much the bound is missed, in its unit; negative if it is kept."""
        short = self.asked - self.achieved
        return -short if rule_kind(self.connectivity).greatest else short

    @property
    def is_missed(self) -> bool:
        """Return whether the bound is missed by more than rounding."""
        return self.missing > RULE_TOLERANCE * max(1.0, abs(self.asked))

    @property
    def words(self) -> str:
        """One line for people."""
        unit = "" if self.unit == "probability" else f" {self.unit}"
        return (
            f"connectivity ({self.connectivity.replace('_', ' ')}): {self.achieved:.4g}{unit}, "
            f"{self.asked:.4g}{unit} asked ({self.method}); slack {self.slack_db:.2f} dB"
        )


@dataclass(frozen=True)
class Certificate:
    """The values that the verifier computed, by code that shares nothing with the solver.

    Attributes
    ----------
    min_clearance_m
        Least distance between the swept path and any obstacle, exact; infinite without obstacles.
    min_connectivity
        Least probability of connection over the planned steps, from the posterior named below.
    dynamics_defect
        Largest violation of the motion model and the input set, in metres.
    kkt_residual
        Unscaled KKT residual of the polished point; None where nothing was polished.
    posterior
        ``exact`` or ``neighbours:192``.
    relaxed_steps
        Steps (1 is the first) at which the bound is not met.
    relaxation_db
        By how many dB at each of them the bound is missed.
    best_margin_db
        At each of them, the best margin (dB, negative) found over every place that the robot
        could reach by then: negative is the proof that the bound could not be met.
    path_cost_m, best_cost_m
        On the way to a goal, where the bound is missed: what the plan and the rest of the way cost
        at the outage price, and what the cheapest path costs that the verifier finds, in metres;
        else None. Infinite where the verifier's grid has no path.
    step_cost_m, step_excess_m
        There as well: what the first step costs, and by how much the cheapest path is dearer after
        it than before, that included. A run's sums of both are bounded by its allowance.
    reasons
        Why the verdict is not ``verified``; empty if it is.
    min_separation_m
        Least distance from any other robot at equal times, all the way; None where no separation
        is asked or there is no other robot. Those that have not planned yet are where their last
        plans lead.
    min_moving_clearance_m
        Least distance from any moving obstacle at equal times, all the way, negative inside one;
        None without one.
    rule
        What is achieved of a rule of connectivity other than p_min at each step where possible.
    """

    min_clearance_m: float
    min_connectivity: float
    dynamics_defect: float
    kkt_residual: float | None
    posterior: str
    relaxed_steps: tuple[int, ...] = ()
    relaxation_db: tuple[float, ...] = ()
    best_margin_db: tuple[float, ...] = ()
    path_cost_m: float | None = None
    best_cost_m: float | None = None
    step_cost_m: float | None = None
    step_excess_m: float | None = None
    reasons: tuple[str, ...] = ()
    min_separation_m: float | None = None
    min_moving_clearance_m: float | None = None
    rule: RuleResult | None = None

    @property
    def excess_m(self) -> float | None:
        """Return the cost beyond the cheapest path found; None where the two cannot be compared."""
        way_m, best_m = self.path_cost_m, self.best_cost_m
        if way_m is None or best_m is None or not math.isfinite(max(way_m, best_m)):
            return None
        return way_m - best_m


def plan_message(certificate: Certificate, positions_m: NDArray[np.float64]) -> str:
    """Describe the faults of a path (N + 1, 2) from the robot on; empty if there are none."""
    parts = list(certificate.reasons)
    rule = certificate.rule
    if rule is not None and rule.slack_db > 0.0:
        if not parts:
            parts.append(
                f"connectivity ({rule.connectivity}) is kept with a slack of {rule.slack_db:.2f} dB"
            )
    elif certificate.relaxed_steps and not parts:
        worst = max(certificate.relaxation_db)
        steps = ", ".join(map(str, certificate.relaxed_steps))
        path_m, best_m = certificate.path_cost_m, certificate.best_cost_m
        if path_m is None or best_m is None:
            parts.append(
                f"the connectivity bound cannot be met from here at steps {steps}; "
                f"it is missed by up to {worst:.2f} dB"
            )
        else:
            parts.append(
                f"steps {steps} miss the connectivity bound by up to {worst:.2f} dB: with them the "
                f"way to the goal costs {path_m:.1f} m, metres out of contact at their price, the "
                f"cheapest found {best_m:.1f} m"
            )
    if np.linalg.norm(positions_m[1:] - positions_m[0], axis=1).max() <= STANDSTILL_M:
        parts.append("the plan stands still")
    return "; ".join(parts)


@dataclass(frozen=True)
class Excused:
    """A step that misses the bound, and what excuses it as far as the verifier found something."""

    step: int  # Its number; 1 is the first
    relaxation_db: float  # By how many dB it misses the bound
    # price: the way is hardly dearer than the cheapest that the verifier found. out_of_reach: no
    # place found within reach keeps the bound by then. slack: within constraints.slack_max_db.
    # none: nothing excuses it, or the verifier found no way to compare with.
    excuse: str
    path_cost_m: float | None = None  # With price: of the way and of the cheapest found; else None
    best_cost_m: float | None = None
    # With out_of_reach: the best margin found within reach, negative; else None
    best_margin_db: float | None = None

    @property
    def words(self) -> str:
        """The step, its miss and the excuse for people."""
        why = "nothing excuses it"
        if self.excuse == "price":
            why = (
                f"the way costs {self.path_cost_m:.1f} m, the cheapest that the verifier found "
                f"{self.best_cost_m:.1f} m"
            )
        elif self.excuse == "slack":
            why = "within constraints.slack_max_db"
        elif self.best_margin_db is not None:
            why = f"the best place found within reach misses it by {-self.best_margin_db:.2f} dB"
        return f"step {self.step} misses p_min by {self.relaxation_db:.2f} dB: {why}"


def excused_steps(proofs: Sequence[Certificate]) -> list[Excused]:
    """Return the steps that miss p_min."""
    if len(proofs) == 1:
        return [_excused(proofs[0], k, step) for k, step in enumerate(proofs[0].relaxed_steps)]
    return [
        _excused(proof, proof.relaxed_steps.index(1), number)
        for number, proof in enumerate(proofs, start=1)
        if 1 in proof.relaxed_steps
    ]


MOST_EXCUSED = 10
"""Steps told of one by one."""


def excused_in_words(steps: Sequence[Excused]) -> list[str]:
    """Lines for people about steps that miss p_min; of many the first, and how many more."""
    lines = [one.words for one in steps[:MOST_EXCUSED]]
    more = len(steps) - MOST_EXCUSED
    return [*lines, f"and {more} more steps"] if more > 0 else lines


def _excused(proof: Certificate, number: int, step: int) -> Excused:
    """The miss of this number in a plan, as step `step`."""
    missed_db = proof.relaxation_db[number]
    if proof.excess_m is not None:
        return Excused(step, missed_db, "price", proof.path_cost_m, proof.best_cost_m)
    if number < len(proof.best_margin_db):
        margin_db = proof.best_margin_db[number]
        if margin_db < 0.0:
            return Excused(step, missed_db, "out_of_reach", best_margin_db=margin_db)
        return Excused(step, missed_db, "none")
    priced = proof.path_cost_m is not None
    return Excused(step, missed_db, "none" if proof.reasons or priced else "slack")


def worst_of(certificates: Sequence[Certificate]) -> Certificate:
    """Return the worst of certificates in each respect, without the steps that miss the bound.

    The costs are those of the plan, and of the step, that cost most beyond the cheapest.
    """
    paths = [
        (one.excess_m, one.path_cost_m, one.best_cost_m)
        for one in certificates
        if one.excess_m is not None
    ]
    steps = [
        (one.step_excess_m, one.step_cost_m)
        for one in certificates
        if one.step_excess_m is not None and one.step_cost_m is not None
    ]
    _, path_m, best_m = max(paths, default=(None, None, None))
    excess_m, step_m = max(steps, default=(None, None))
    return Certificate(
        min_clearance_m=min(one.min_clearance_m for one in certificates),
        min_connectivity=min(one.min_connectivity for one in certificates),
        dynamics_defect=max(one.dynamics_defect for one in certificates),
        kkt_residual=_extreme(max, (one.kkt_residual for one in certificates)),
        posterior=max((one.posterior for one in certificates), key=lambda kind: kind != "exact"),
        path_cost_m=path_m,
        best_cost_m=best_m,
        step_cost_m=step_m,
        step_excess_m=excess_m,
        reasons=tuple(reason for one in certificates for reason in one.reasons),
        min_separation_m=_extreme(min, (one.min_separation_m for one in certificates)),
        min_moving_clearance_m=_extreme(min, (one.min_moving_clearance_m for one in certificates)),
        rule=max(
            (one.rule for one in certificates if one.rule is not None),
            key=lambda rule: (rule.slack_db, rule.missing),
            default=None,
        ),
    )


def _extreme(
    least_or_most: Callable[[list[float]], float], values: Iterable[float | None]
) -> float | None:
    """Return the extreme of the numbers that there are; None if there is none."""
    numbers = [value for value in values if value is not None]
    return least_or_most(numbers) if numbers else None
