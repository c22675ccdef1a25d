"""Findings of the verifier on a plan: certificate, rule result, coverage holes, explanations."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.channel.kriging import Prediction, bound_margin_db, connection_probability
from planopt.errors import NoPlanError
from planopt.planning.tolerances import RULE_TOLERANCE, STANDSTILL_M
from planopt.problems.objective import RULES
from planopt.problems.problem import Problem

MOST_IN_WORDS = 4  # Maximum number of coverage holes in a description, longest first
SHORTEST_IN_WORDS_M = 0.5  # Minimum length of a coverage hole in a description, in metres


@dataclass(frozen=True)
class Hole:
    """Coverage hole: part of a path on which P(connected) is below the required probability."""

    from_m: tuple[float, float]  # (x, y) of its first and last position below the bound
    to_m: tuple[float, float]
    length_m: float  # Length below the bound, including half of entry and exit steps
    least_connectivity: float  # Minimum probability of connection in the hole
    to_end: bool  # Whether the path ends in the hole

    @property
    def words(self) -> str:
        """Return text on the location and length of the hole."""
        x, y = self.from_m
        return (
            f"{self.length_m:.0f} m that begins at ({x:.1f}, {y:.1f}) m (lowest P(connected) "
            f"{self.least_connectivity:.2f})"
        )


@dataclass(frozen=True, eq=False)
class BlockedPath:
    """Cheapest path of a robot to its goal if all paths violate a hard connectivity bound.

    Attributes
    ----------
    robot
        Name of the robot.
    path_m
        ``(n, 2)`` positions from the robot to the goal.
    holes
        Stretches that violate the bound, in path order.
    """

    robot: str
    path_m: Floats
    holes: tuple[Hole, ...]


class BlockedError(NoPlanError):
    """Error raised if no path to a goal satisfies a hard connectivity bound.

    Parameters
    ----------
    message
        Description of the coverage holes of the cheapest path.
    blocked
        The cheapest path of each blocked robot.
    """

    def __init__(self, message: str, blocked: tuple[BlockedPath, ...]) -> None:
        super().__init__(message)
        self.blocked = blocked


def required_margins_db(problem: Problem, power: Prediction) -> Floats:
    """Return the margins (n,) in dB by which predicted powers satisfy p_min."""
    return bound_margin_db(
        power.mean_db,
        power.deviation_db,
        problem.stations[0].threshold_dbm,
        problem.constraints.p_min,
    )


def holes_along(places_m: Floats, connectivity: Floats, is_below: Mask) -> tuple[Hole, ...]:
    """Return the coverage holes of a path from its probabilities of connection."""
    # Shapes: places_m (n, 2), positions of the path; connectivity (n,), P(connected); is_below
    # (n,), whether P(connected) violates the bound.
    lengths = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
    share = 0.5 * (is_below[:-1].astype(float) + is_below[1:]) * lengths
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_below.astype(int), [0]])))
    holes: list[Hole] = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        begin, finish = places_m[first].tolist(), places_m[end - 1].tolist()
        holes.append(
            Hole(
                (begin[0], begin[1]),
                (finish[0], finish[1]),
                float(share[max(first - 1, 0) : end].sum()),
                float(connectivity[first:end].min()),
                end == len(places_m),
            )
        )
    return tuple(holes)


def holes_on(problem: Problem, power: Prediction, places_m: Floats) -> tuple[Hole, ...]:
    """Return the coverage holes of a path (n, 2), along which the predicted power is `power`."""
    threshold = problem.stations[0].threshold_dbm
    chance = connection_probability(power.mean_db, power.deviation_db, threshold)
    slack_db = problem.constraints.rule.slack_max_db or 0.0
    return holes_along(places_m, chance, required_margins_db(problem, power) < -slack_db)


def named_holes(holes: Sequence[Hole], before: str) -> list[str]:
    """Return texts on the longest holes, each prefixed by `before`, and the number of others."""
    longest = sorted(holes, key=lambda hole: -hole.length_m)[:MOST_IN_WORDS]
    named = [f"{before}{hole.words}" for hole in holes if hole in longest]
    left = len(holes) - len(longest)
    return [*named, f"{left} shorter {'hole' if left == 1 else 'holes'}"] if left > 0 else named


def holes_in_words(problem: Problem, holes: Sequence[Hole], verb: str = "crosses") -> list[str]:
    """Return lines of text that describe the coverage holes on the path to a goal."""
    holes = [hole for hole in holes if hole.length_m >= SHORTEST_IN_WORDS_M]
    if not holes:
        return []
    lines = named_holes(holes, f"{verb} a coverage hole of ")
    if len(lines) > MOST_IN_WORDS:
        lines[-1] = f"{verb} {lines[-1]}"
    if len(holes) > 1:
        total = sum(hole.length_m for hole in holes)
        p_min = problem.constraints.p_min
        lines.append(f"total length with P(connected) below {p_min:g}: {total:.0f} m")
    return lines


def goal_in_words(problem: Problem, holes: Sequence[Hole]) -> list[str]:
    """Return a line if the goal itself is in a coverage hole; otherwise no lines."""
    if not holes or not holes[-1].to_end:
        return []
    x, y = problem.goal_m
    return [
        f"P(connected) at the goal ({x:g}, {y:g}) m is below {problem.constraints.p_min:g} "
        "according to the measurements so far"
    ]


@dataclass(frozen=True)
class RuleResult:
    """Required and achieved value of a connectivity rule for a whole plan.

    Attributes
    ----------
    connectivity
        Name of the rule.
    achieved, required
        Achieved value, and the required minimum (for ``outage``, the allowed maximum).
    unit
        ``probability``, ``m``, ``s``, ``Mbit`` or ``steps``.
    method
        Method of computation.
    slack_db
        Smallest reduction of the threshold, within the allowed slack, for which the path satisfies
        the rule.
    """

    connectivity: str
    achieved: float
    required: float
    unit: str
    method: str
    slack_db: float = 0.0

    @property
    def missing(self) -> float:
        """Return the shortfall in the rule's unit; negative if the rule is satisfied."""
        short = self.required - self.achieved
        return -short if RULES.find(self.connectivity).greatest else short

    @property
    def is_missed(self) -> bool:
        """Return whether the rule is violated by more than rounding errors."""
        return self.missing > RULE_TOLERANCE * max(1.0, abs(self.required))

    @property
    def words(self) -> str:
        """Return a one-line description of achieved and required value."""
        unit = "" if self.unit == "probability" else f" {self.unit}"
        slack = f", with the threshold {self.slack_db:.2f} dB lower" if self.slack_db else ""
        most = "most" if RULES.find(self.connectivity).greatest else "least"
        return (
            f"connectivity rule {self.connectivity}: {self.achieved:.4g}{unit}; required: at "
            f"{most} {self.required:.4g}{unit} (computed by: {self.method}){slack}"
        )


@dataclass(frozen=True)
class Certificate:
    """Results of the verifier, whose code is independent of the solver.

    Attributes
    ----------
    min_clearance_m
        Exact minimum distance between swept path and obstacles; infinite without obstacles.
    min_connectivity
        Minimum probability of connection over the planned steps.
    dynamics_defect
        Largest violation of the motion model and the input set, in metres.
    kkt_residual
        Unscaled KKT residual of the refined path; None without refinement.
    posterior
        ``exact`` or ``neighbours:192``.
    relaxed_steps, relaxation_db
        Steps (1 is the first) that violate p_min, and the shortfall of each in dB.
    best_margin_db
        For each of these steps, the best margin (dB) of all positions reachable by then: a negative
        margin proves that p_min could not be satisfied.
    path_cost_m, best_cost_m
        If a plan to a goal violates p_min: its cost in metres at the outage price, including
        cost-to-go, and the cost of the cheapest path that the verifier finds; otherwise None.
        Infinite if the verifier's grid has no path.
    step_cost_m, step_excess_m
        Cost of the first step, and this cost plus the change of the optimal cost-to-go over the
        step; None or infinite as above. The sums of both over a run are bounded.
    reasons
        Reasons why the verdict is not ``verified``; empty if it is.
    min_separation_m
        Minimum distance to any other robot at equal times; None without other robots or a
        separation. Robots that plan later are represented by their previous plans.
    min_moving_clearance_m
        Minimum distance to moving obstacles at equal times (negative: inside); None without any.
    rule
        Result of a non-default connectivity rule.
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
        """Return the plan's excess cost over the cheapest path found; None if not comparable."""
        path_m, best_m = self.path_cost_m, self.best_cost_m
        if path_m is None or best_m is None or not math.isfinite(max(path_m, best_m)):
            return None
        return path_m - best_m


def plan_message(certificate: Certificate, positions_m: Floats) -> str:
    """Return a description of the faults of a path (N + 1, 2); empty if it has none."""
    parts = list(certificate.reasons)
    rule = certificate.rule
    if rule is not None and rule.slack_db > 0.0:
        if not parts:
            parts.append(
                f"connectivity rule {rule.connectivity} holds if the power threshold is lowered by "
                f"{rule.slack_db:.2f} dB (slack)"
            )
    elif certificate.relaxed_steps and not parts:
        worst = max(certificate.relaxation_db)
        steps = steps_in_words(certificate.relaxed_steps)
        path_m, best_m = certificate.path_cost_m, certificate.best_cost_m
        if path_m is None or best_m is None:
            parts.append(
                f"no position within reach has the required P(connected) at {steps}; "
                f"up to {worst:.2f} dB below the power needed"
            )
        else:
            parts.append(
                f"P(connected) is below the required value at {steps}: the power is up to "
                f"{worst:.2f} dB too low. The verifier accepts this, because avoiding it is not "
                f"cheaper: length plus outage penalty is {path_m:.1f} m for plan and remaining "
                f"route, and {best_m:.1f} m for the cheapest route found, within the tolerance"
            )
    if np.linalg.norm(positions_m[1:] - positions_m[0], axis=1).max() <= STANDSTILL_M:
        parts.append("the plan stands still")
    return "; ".join(parts)


def steps_in_words(steps: Sequence[int]) -> str:
    """Return step numbers as text, with ranges of consecutive steps."""
    first = [step for step in steps if step - 1 not in steps]
    last = [step for step in steps if step + 1 not in steps]
    ranges = [f"{a}" if a == b else f"{a} to {b}" for a, b in zip(first, last, strict=True)]
    return f"{'step' if len(steps) == 1 else 'steps'} {', '.join(ranges)}"


@dataclass(frozen=True)
class Excused:
    """Step that violates p_min, with the reason why the verifier excuses it."""

    step: int  # Step number; 1 is the first
    relaxation_db: float  # Shortfall in dB
    # price: plan at most slightly costlier than the cheapest path. out_of_reach: no position
    # reachable by then meets the bound. slack: within constraints.slack_max_db. none: no excuse.
    excuse: str
    path_cost_m: float | None = None  # For price: costs of plan and cheapest path
    best_cost_m: float | None = None
    best_margin_db: float | None = None  # For out_of_reach: largest reachable margin (negative)

    @property
    def words(self) -> str:
        """Return text on the step, its shortfall and the reason why it is excused."""
        why = "nothing excuses it"
        if self.excuse == "price":
            why = (
                f"the route has a priced length of {self.path_cost_m:.1f} m, and the cheapest "
                f"route that the verifier found has {self.best_cost_m:.1f} m"
            )
        elif self.excuse == "slack":
            why = "within constraints.slack_max_db"
        elif self.best_margin_db is not None:
            why = f"the best reachable position misses it by {-self.best_margin_db:.2f} dB"
        return f"step {self.step} misses p_min by {self.relaxation_db:.2f} dB of power: {why}"


def excused_steps(proofs: Sequence[Certificate]) -> list[Excused]:
    """Return the excused steps of one plan, or the excused first steps of a run's plans."""
    if len(proofs) == 1:
        return [_excused(proofs[0], k, step) for k, step in enumerate(proofs[0].relaxed_steps)]
    return [
        _excused(proof, proof.relaxed_steps.index(1), number)
        for number, proof in enumerate(proofs, start=1)
        if 1 in proof.relaxed_steps
    ]


MOST_EXCUSED = 3  # Maximum number of excused steps in a description


def excused_in_words(steps: Sequence[Excused]) -> list[str]:
    """Return text on the first steps that violate p_min, and the number of further ones."""
    lines = [one.words for one in steps[:MOST_EXCUSED]]
    more = len(steps) - MOST_EXCUSED
    return [*lines, f"and {more} more steps below p_min"] if more > 0 else lines


def _excused(proof: Certificate, number: int, step: int) -> Excused:
    """Return the excuse for step number `step`, which is entry `number` of `relaxed_steps`."""
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
    """Return the worst value of every entry as one certificate that lists no violating steps."""
    # Costs are those of the plan, and of the step, with the largest excess over the cheapest path.
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
        kkt_residual=max(_known(one.kkt_residual for one in certificates), default=None),
        posterior=max((one.posterior for one in certificates), key=lambda kind: kind != "exact"),
        path_cost_m=path_m,
        best_cost_m=best_m,
        step_cost_m=step_m,
        step_excess_m=excess_m,
        reasons=tuple(reason for one in certificates for reason in one.reasons),
        min_separation_m=min(_known(one.min_separation_m for one in certificates), default=None),
        min_moving_clearance_m=min(
            _known(one.min_moving_clearance_m for one in certificates), default=None
        ),
        rule=max(
            (one.rule for one in certificates if one.rule is not None),
            key=lambda rule: (rule.slack_db, rule.missing),
            default=None,
        ),
    )


def _known(values: Iterable[float | None]) -> list[float]:
    """Return the values that are not None."""
    return [value for value in values if value is not None]


def worst_of_robots(certificates: Mapping[str, Certificate]) -> Certificate:
    """Return the robots' worst values as one certificate; each reason names its robot."""
    each = tuple(certificates.values())
    if len(each) == 1:
        return each[0]
    relaxation: dict[int, float] = {}
    best: dict[int, float] = {}
    for one in each:
        for step, missing_db in zip(one.relaxed_steps, one.relaxation_db, strict=True):
            relaxation[step] = max(missing_db, relaxation.get(step, 0.0))
        for step, margin_db in zip(one.relaxed_steps, one.best_margin_db, strict=False):
            best[step] = min(margin_db, best.get(step, margin_db))
    return replace(
        worst_of(each),
        relaxed_steps=tuple(sorted(relaxation)),
        relaxation_db=tuple(relaxation[step] for step in sorted(relaxation)),
        best_margin_db=tuple(best[step] for step in sorted(best)),
        reasons=tuple(
            f"{robot}: {reason}" for robot, one in certificates.items() for reason in one.reasons
        ),
    )


LIMITS = ("robots[", "planner.", "world.")
"""Prefixes of keys that limit the robot or the planner, rather than state a requirement."""


@dataclass(frozen=True)
class Relaxation:
    """Key of the problem file that prevents a verified plan, and a value that would suffice.

    Each relaxation with ``verified=True`` is sufficient by itself.

    Attributes
    ----------
    constraint
        Problem file key, such as ``constraints.p_min``.
    unit
        Unit of `value` and `relaxed_value`; empty for a probability or a count.
    value
        The required value; None for an obstacle.
    stages
        Steps (1 is the first) that violate the constraint; empty if it does not apply to steps.
    shortfall, shortfall_unit
        Largest violation over these steps with its unit; None if not numerical.
    relaxed_value
        Sufficient value found nearest to `value`; None for an obstacle, which has to be
        removed.
    verified
        Whether the problem solved with this relaxation has a verified plan.
    robot
        Name of the robot.
    """

    constraint: str
    unit: str
    value: float | None
    stages: tuple[int, ...]
    shortfall: float | None
    shortfall_unit: str
    relaxed_value: float | None
    verified: bool
    robot: str

    def __str__(self) -> str:
        """Return a sentence that describes the relaxation."""
        key = self.constraint
        if self.value is not None:
            key += f" = {_shown(self.value, self.unit)}"
        fails = "prevents a plan" if self.constraint.startswith(LIMITS) else "cannot be met"
        where = f" at {steps_in_words(self.stages)}" if self.stages else ""
        short = "" if self.shortfall is None else _shown(self.shortfall, self.shortfall_unit)
        by = f", short by {short}" if short else ""
        change = (
            f"without this {'obstacle' if self.value is None else 'limit'} there is a plan"
            if self.relaxed_value is None
            else f"{_shown(self.relaxed_value, self.unit)} would suffice"
        )
        proof = "confirmed" if self.verified else "not confirmed"
        return f"{key} {fails}{where}{by}; {change} ({proof} by solving again)"


@dataclass(frozen=True)
class Crossing:
    """Coverage holes on a path to a goal, and the path with the least outage.

    Attributes
    ----------
    robot
        Name of the robot.
    holes
        Coverage holes in path order.
    cost_m
        Cost of the cheapest lattice path, in metres at `outage_price`.
    outage_price
        Value of ``objective.outage_price``.
    kept_m
        Length of the path with the shortest distance out of contact.
    outside_m
        Distance out of contact on that path; zero if it satisfies the chance constraint.
    p_min
        Required probability of connection.
    """

    robot: str
    holes: tuple[Hole, ...]
    cost_m: float
    outage_price: float
    kept_m: float
    outside_m: float
    p_min: float

    @property
    def at_goal(self) -> bool:
        """Return whether the goal itself violates p_min."""
        return bool(self.holes) and self.holes[-1].to_end

    @property
    def why(self) -> str:
        """Return text on the cost of the path and on the best-connected alternative."""
        if self.outside_m < SHORTEST_IN_WORDS_M and not self.at_goal:
            return (
                f"The shortest lattice route that stays connected is {self.kept_m:.0f} m long. "
                f"The cheapest lattice route has a priced length of {self.cost_m:.0f} m: its "
                f"length plus {self.outage_price:g} m for each metre expected out of contact."
            )
        length, outside = f"{self.kept_m:.0f} m", f"{self.outside_m:.0f} m"
        part = f"all of its {length}" if outside == length else f"{outside} of its {length}"
        return (
            "No lattice route stays connected throughout: the one with the least outage has "
            f"P(connected) below {self.p_min:g} over {part}."
        )

    def __str__(self) -> str:
        """Return text on locations and lengths of the holes, and on why they are crossed."""
        where = "; ".join(hole.words for hole in self.holes)
        goal = ", also at the goal itself" if self.at_goal else ""
        return f"P(connected) is below {self.p_min:g} for {where}{goal}. {self.why}"


class Explanation(tuple[Relaxation | Crossing, ...]):
    """Tuple of relaxations and crossings, with a summary.

    Attributes
    ----------
    summary
        Text that says whether all plans are verified and, if not, whether a tested change helps.
    """

    summary: str

    def __new__(cls, found: Iterable[Relaxation | Crossing] = (), summary: str = "") -> Explanation:
        """Create the tuple with its summary."""
        made = super().__new__(cls, found)
        made.summary = summary
        return made

    def __str__(self) -> str:
        """Return text with the summary and a line for each entry."""
        return "\n".join([self.summary, *map(str, self)])


def _shown(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".strip()
