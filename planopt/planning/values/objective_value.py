"""Objective of a path (the weighted sum of terms, or the cost to a goal), and rows of its rule.

A rule on single steps constrains each of them by p_min. Any other rule becomes one row, a weighted
sum of the probabilities: the tangent of the achieved value.
"""

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.channel.kriging import (
    Prediction,
    bound_margin_db,
    bound_quantile,
    connection_probability,
)
from planopt.errors import InputError
from planopt.objectives.path_derivatives import LocalPaths
from planopt.objectives.terms.term import Term
from planopt.parts import calling, returned
from planopt.planning.certificate import RuleResult, required_margins_db
from planopt.planning.plan import History, Pivot
from planopt.planning.proof.rule import PathCase, Rule, rule_of, whole_plan_result
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB
from planopt.planning.values.context import StepContext
from planopt.problems.problem import Problem, charged_length_m, outage_share, rate_s_m, steps_cost_s
from planopt.robots.dynamics import Drive


@dataclass(frozen=True)
class ObjectiveValue:
    """Objective value of paths in one step context."""

    context: StepContext

    def __call__(self, path_m: Floats, drive: Drive | None = None) -> float:
        """Return the weighted sum of the terms for a path (N, 2), minus the cost of its slack."""
        del drive  # values of terms depend on positions alone
        return float(sum(self.by_term(path_m))) - slack_cost(self.context, path_m)

    def by_term(self, path_m: Floats) -> tuple[float, ...]:
        """Return the contribution of each term of the objective, including its weight."""
        return tuple(self._contributed(number, path_m) for number in range(len(self._terms)))

    def of_each(self, paths_m: Sequence[Floats]) -> list[float]:
        """Return the objective values of several paths, with one batch of power predictions."""
        for path in paths_m:
            self.context.soon(path)
        total = np.zeros(len(paths_m))
        for number in range(len(self._terms)):
            total += self._of_term(number, paths_m)
        return [
            value - slack_cost(self.context, path)
            for value, path in zip(total.tolist(), paths_m, strict=True)
        ]

    def _of_term(self, number: int, paths_m: Sequence[Floats]) -> Floats:
        """Return the weighted contribution (c,) of term `number` to the objective of c paths."""
        term, at = self._terms[number], self.context
        if not term.probes_end or not paths_m:
            return np.array([self._contributed(number, path) for path in paths_m])
        paths = np.array(paths_m)
        power = at.power(paths.reshape(-1, 2))
        chance = connection_probability(power.mean_db, power.deviation_db, at.law.thresholds_dbm[0])
        return probe_values(at, number, paths, chance.reshape(paths.shape[:2]))

    @property
    def _terms(self) -> tuple[Term, ...]:
        return self.context.problem.terms

    def _contributed(self, number: int, path_m: Floats) -> float:
        term = self._terms[number]
        with _named(self.context, number):
            with calling(term, "value", key="value"):
                value = term.value(self.context, path_m)
            words = "one finite number"
            return term.weight * float(returned(term, "value", value, (), words=words, key="value"))


def probe_values(at: StepContext, number: int, paths_m: Floats, chance: Floats) -> Floats:
    """Return the weighted contribution (c,) of term `number` for paths with probed ends."""
    # Shapes: paths_m (c, N, 2); chance (c, N).
    term, method = at.problem.terms[number], "probe_values"
    words = "one finite number for each path"
    with _named(at, number):
        with calling(term, method, key=method):
            found = term.probe_values(at, paths_m, chance)
        return term.weight * returned(term, method, found, (len(paths_m),), words=words, key=method)


@contextmanager
def _named(at: StepContext, number: int) -> Generator[None]:
    """Add the name of term `number` to InputErrors that it raises."""
    try:
        yield
    except InputError as error:
        if error.key is None or error.key.startswith("objective"):
            raise
        raise error.under(f"objective.terms[{number}]").located(at.problem.file) from error


SHARE_IN_DB = 100.0  # Cost in dB of a relative shortfall of one, for a rule over a whole plan


def slack_cost(at: StepContext, path_m: Floats) -> float:
    """Return the cost of the slack of a path (N, 2), in the objective's unit."""
    rule = at.problem.constraints.rule
    if rule.slack_price == 0.0:
        return 0.0
    if rule.by_step:
        return rule.slack_price * float(_missed_db(at, path_m).sum())
    result = rule_result(at, path_m)
    beyond = result.slack_db == 0.0 and result.is_missed
    return rule.slack_price * ((rule.slack_max_db or 0.0) if beyond else result.slack_db)


def rule_missing(at: StepContext, path_m: Floats) -> float:
    """Return the rule's violation by a path (N, 2) beyond its slack; 0 if it is satisfied."""
    # In dB, summed over steps; for a whole plan the relative shortfall in `SHARE_IN_DB`.
    constraints = at.problem.constraints
    if not constraints.requires_connection:
        return 0.0
    if constraints.rule.by_step:
        missed = _missed_db(at, path_m) - (constraints.rule.slack_max_db or 0.0)
        return float(missed[missed > MARGIN_TOLERANCE_DB].sum())
    result = rule_result(at, path_m)
    if result.slack_db > 0.0 or not result.is_missed:
        return 0.0
    return SHARE_IN_DB * result.missing / max(result.required, 1.0)


def _missed_db(at: StepContext, path_m: Floats) -> Floats:
    """Return the shortfall of p_min in dB at each constrained step as an array (N,)."""
    power, problem = at.power(path_m), at.problem
    margins = required_margins_db(problem, power)
    missed = margins < -MARGIN_TOLERANCE_DB
    counted = rule_of(problem).counted(at.history, len(path_m))
    return np.where(missed & counted, -margins, 0.0)


def rule_result(at: StepContext, path_m: Floats) -> RuleResult:
    """Return the verifier's result of the rule for a path (N, 2)."""
    places_m = np.vstack([at.position_m, path_m])
    return whole_plan_result(PathCase(at, places_m, at.power(path_m)))


LeadingPivot = Callable[[Floats], Pivot]
"""Function from a path's end (2,) to the pivot of the remaining route."""
BRAKING_PLACES = 9  # Number of positions on the braking path at which outage is evaluated


@dataclass(frozen=True)
class ReachCost:
    """Cost of paths to a goal, in one planning step."""

    problem: Problem  # Problem with a goal
    position_m: Floats  # (2,) position of the robot
    # Maps positions (n, 2) to predicted power, for p_min and outage
    power: Callable[[Floats], Prediction]
    ahead: LeadingPivot | None = None  # None if no cost-to-go is charged
    # Whether outage is priced; False for a robot that has wandered
    priced: bool = True

    @property
    def outage_price(self) -> float:
        """Return the price of a metre out of contact; zero if outage is not priced."""
        return self.problem.reach.outage_price if self.priced else 0.0

    @property
    def rate_s_m(self) -> float:
        """Cost in seconds per metre beyond the horizon."""
        return rate_s_m(self.problem)

    def __call__(self, path_m: Floats, drive: Drive | None = None) -> float:
        """Return the cost of a path (N, 2) in seconds, including outage price and cost-to-go."""
        resting = None if drive is None else resting_places_m(drive)
        places = np.vstack([self.position_m, path_m])
        cost = steps_cost_s(self.problem, places, resting)
        if self.priced:
            cost += self.rate_s_m * self.outage_price * self._charged_m(places)
        if self.ahead is None:
            return cost
        end = path_m[-1] if resting is None else resting[-1]
        if resting is not None and self.priced:
            along = np.linspace(0.0, 1.0, BRAKING_PLACES)[:, None]
            braking = path_m[-1] + along * (end - path_m[-1])
            cost += self.rate_s_m * self.outage_price * self._charged_m(braking)
        pivot = self.ahead(end)
        to_pivot = float(np.linalg.norm(end - pivot.position_m))
        if drive is not None:
            x, y = pivot.position_m
            cost += float(drive.dynamics.turning_s(tuple(drive.states[-1]), (x, y)))
        return cost + self.rate_s_m * (pivot.metre_cost * to_pivot + pivot.cost_m)

    def pivot_of(self, path_m: Floats, drive: Drive | None = None) -> Pivot | None:
        """Return the pivot for the cost-to-go of a path (N, 2); None without cost-to-go."""
        end = path_m[-1] if drive is None else resting_places_m(drive)[-1]
        return None if self.ahead is None else self.ahead(end)

    @property
    def threshold_dbm(self) -> float:
        """Power threshold of connection, minus the allowed slack."""
        slack_db = self.problem.constraints.rule.slack_max_db or 0.0
        return self.problem.stations[0].threshold_dbm - slack_db

    def _charged_m(self, places_m: Floats) -> float:
        """Return the length in metres of a path (N + 1, 2) that is penalised as out of contact."""
        lengths = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
        return charged_length_m(lengths, self._outage_share(places_m))

    def _outage_share(self, places_m: Floats) -> Floats:
        power, threshold = self.power(places_m), self.threshold_dbm
        mean, deviation = power.mean_db, power.deviation_db
        chance = connection_probability(mean, deviation, threshold)
        return outage_share(chance, self._is_below(power), self._everywhere)

    def metre_costs(self, path_m: Floats) -> Floats:
        """Return the costs per metre (N + 1,) at the robot and along a path (N, 2)."""
        places = np.vstack([self.position_m, path_m])
        return 1.0 + self.outage_price * self._outage_share(places)

    def outage_charges(self, path_m: Floats) -> tuple[float, Floats]:
        """Return the penalised share of a metre at the robot, and upper bounds (N,) on a path."""
        # The second value, (N,), is the fraction if connection were impossible.
        below = self._is_below(self.power(path_m))
        certain = outage_share(np.zeros(len(path_m)), below, self._everywhere)
        return float(self._outage_share(self.position_m[None])[0]), certain

    @property
    def _everywhere(self) -> bool:
        return self.problem.reach.charges_everywhere

    def _is_below(self, power: Prediction) -> Mask:
        margin = bound_margin_db(
            power.mean_db, power.deviation_db, self.threshold_dbm, self.problem.constraints.p_min
        )
        return margin < 0.0


def resting_places_m(drive: Drive) -> Floats:
    """Return the resting positions (N + 1, 2) after braking from each state of a drive."""
    return np.column_stack(drive.dynamics.resting_place(tuple(drive.states.T)))


UNCONSTRAINED = 0.5  # Probability level that stands for an unconstrained step
LEAST_LEVEL = 1e-3  # Minimum distance of a step's probability level from 0 and 1
LEVEL_HALVINGS = 20  # Number of bisections for the common probability level of all steps


@dataclass(frozen=True, eq=False)
class RuleRows:
    """Constraint rows of the connectivity rule for a path of N steps."""

    threshold_dbm: float  # Power threshold of connection
    level: Floats  # (N,) required probability of each step
    bounded: Mask  # (N,) whether the step is constrained
    # (N,) weights of the probabilities in the sum; None if no sum is bounded
    weight: Floats | None = None
    total: float = 0.0  # Lower bound of the sum

    @cached_property
    def quantile(self) -> Floats:
        """Return the normal quantiles z_p (N,) of the steps' required probabilities."""
        return np.array([bound_quantile(level) for level in self.level.tolist()])

    def margins_db(self, power: Prediction) -> Floats:
        """Return each step's margin in dB at its required probability; inf if unconstrained."""
        margins = power.mean_db - self.quantile * power.deviation_db - self.threshold_dbm
        return np.where(self.bounded, margins, np.inf)

    def achieved(self, power: Prediction) -> Floats:
        """Return the value of each row: the steps' margins (N,), or the sum (1,)."""
        return self.margins_db(power) if self.weight is None else np.array([self.sum_of(power)])

    def per_db(self, power: Prediction) -> float:
        """Return the derivative of the rows w.r.t. a threshold reduction in dB; always positive."""
        if self.weight is None:
            return 1.0
        score = (power.mean_db - self.threshold_dbm) / power.deviation_db
        density = np.exp(-0.5 * score**2) / (np.sqrt(2.0 * np.pi) * power.deviation_db)
        least = max(1e-3 * float(self.weight.max(initial=0.0)), 1e-9)
        return max(float(self.weight @ density), least)

    def shortfall_db(self, power: Prediction) -> Floats:
        """Return the shortfall of each row in dB, to first order."""
        return (self.total - self.achieved(power)) / self.per_db(power)

    def sum_of(self, power: Prediction) -> float:
        """Return the weighted sum of connection probabilities at predicted powers."""
        if self.weight is None:
            raise AssertionError("no sum is bounded")
        chance = connection_probability(power.mean_db, power.deviation_db, self.threshold_dbm)
        return float(self.weight @ chance)


def has_sum_row(problem: Problem) -> bool:
    """Return whether the rule constrains a sum over the steps."""
    return not problem.constraints.rule.kind.holds_steps


def has_step_rows(problem: Problem) -> bool:
    """Return whether the rule constrains single steps."""
    return problem.constraints.requires_connection and not has_sum_row(problem)


def rule_rows(context: StepContext, path_m: Floats) -> RuleRows:
    """Return the constraint rows for a refinement of `path_m` (N, 2)."""
    problem, history = context.problem, context.history
    legs = np.linalg.norm(np.diff(np.vstack([context.position_m, path_m]), axis=0), axis=1)
    rule, p_min, count = rule_of(problem, legs), problem.constraints.p_min, len(path_m)
    threshold = problem.stations[0].threshold_dbm
    power = context.predicted(path_m)
    if rule.holds_steps:
        keeps = required_margins_db(problem, power) >= 0.0
        bounded = rule.held(keeps, history) & problem.constraints.requires_connection
        return RuleRows(threshold, np.where(bounded, p_min, UNCONSTRAINED), bounded)
    chance = connection_probability(power.mean_db, power.deviation_db, threshold)
    achieved, slope = rule.slopes(chance, history)
    least = rule.required(p_min, history, count)
    if rule.correlates(p_min):
        result = rule_result(context, path_m)
        if not result.is_missed:
            least = min(least, scaled_value(rule, context, float(achieved), count, result))
    none = np.zeros(count, dtype=np.bool_)
    total = least - float(achieved) + float(slope @ chance)
    return RuleRows(threshold, np.full(count, UNCONSTRAINED), none, slope, total)


LARGEST_FACTOR = 4.0
"""Maximum factor by which the shortfall from the maximum value is scaled up or down."""


def scaled_value(
    rule: Rule, context: StepContext, achieved: float, count: int, result: RuleResult
) -> float:
    """Return the required value that matches the allowed risk (equation 5.7)."""
    # The value's shortfall from that of certain connection is scaled by allowed over verified risk.
    most = float(rule.valued(np.ones(count), context.history))
    factor = (1.0 - result.required) / max(1.0 - result.achieved, 1e-12)
    return most - (most - achieved) * float(np.clip(factor, 1.0 / LARGEST_FACTOR, LARGEST_FACTOR))


AIMED_SHARE = 0.98  # Fraction of the distance to the allowed risk that the secant step covers
USED_SHARE = 0.9
"""Fraction of its allowed shortfall from which a row counts as active in the solver."""
USED_UP_SHARE = 0.97  # Fraction of the allowed risk from which risk is not reallocated


def rows_again(
    context: StepContext,
    rows: RuleRows,
    path_m: Floats,
    earlier: list[tuple[float, RuleResult]],
    result: RuleResult,
) -> RuleRows | None:
    """Return constraint rows corrected by a path's verified result; None without a correction."""
    # Secant of the last feasible and infeasible paths, or half of it on the same side.
    rule, history = rule_of(context.problem), context.history
    if not rule.correlates(context.problem.constraints.p_min) or rows.weight is None:
        return None
    allowed, found = 1.0 - result.required, 1.0 - result.achieved
    power, most = context.predicted(path_m), float(rows.weight.sum())
    is_held = most - rows.sum_of(power) >= USED_SHARE * (most - rows.total)
    kept = not result.is_missed or result.slack_db > 0.0
    if kept and (found >= USED_UP_SHARE * allowed or not is_held):
        return None
    chance = connection_probability(power.mean_db, power.deviation_db, rows.threshold_dbm)
    earlier.append((float(rule.valued(chance, history)), result))
    within = [(value, 1.0 - one.achieved) for value, one in earlier if not one.is_missed]
    beyond = [(value, 1.0 - one.achieved) for value, one in earlier if one.is_missed]
    if within and beyond:
        (low, low_risk), (high, high_risk) = within[-1], beyond[-1]
        share = AIMED_SHARE * (allowed - low_risk) / max(high_risk - low_risk, 1e-12)
        if len(earlier) > 2 and earlier[-1][1].is_missed == earlier[-2][1].is_missed:
            share = 0.5
        value = low + share * (high - low)
    else:
        value = scaled_value(rule, context, earlier[-1][0], len(path_m), result)
    achieved, slope = rule.slopes(chance, history)
    return replace(rows, weight=slope, total=value - float(achieved) + float(slope @ chance))


def step_rows(context: StepContext, path_m: Floats) -> RuleRows:
    """Return constraint rows on single steps that approximate the rule near a path (N, 2)."""
    # A constraint on a sum becomes one per step; the path's surplus or deficit is spread evenly.
    rows = rule_rows(context, path_m)
    if rows.weight is None:
        return rows
    power = context.predicted(path_m)
    chance = connection_probability(power.mean_db, power.deviation_db, rows.threshold_dbm)
    spare = (rows.sum_of(power) - rows.total) / max(float(rows.weight.sum()), 1e-9)
    level = chance - spare
    bounded = (rows.weight > 0.0) & (level > LEAST_LEVEL)
    level = np.clip(level, LEAST_LEVEL, 1.0 - LEAST_LEVEL)
    return RuleRows(rows.threshold_dbm, np.where(bounded, level, UNCONSTRAINED), bounded)


@dataclass(frozen=True, eq=False)
class Guide:
    """Guide of a lattice search: constrained steps, required probability, connection rewards."""

    level: float  # Required probability of the constrained steps
    bounded: Mask  # (N,) mask of the constrained steps
    # (N,) reward of a certain connection relative to the largest reward of a step
    credit: Floats


GuidedSearch = Callable[[Guide], list[Floats]]
"""Function that maps a guide to the best paths (N, 2), best first."""
IsKept = Callable[[Floats], bool]
"""Function that returns whether a path (N, 2) satisfies the rule."""
HIGHEST_CREDIT, LOWEST_CREDIT = 10.0, 1e-3
"""Largest and smallest credit of a connected step, relative to the largest reward of a step."""
CREDIT_HALVINGS = 5  # Number of bisections of the credit on a logarithmic scale
PATTERNS = 4  # Maximum number of patterns of constrained steps that are searched


def find_guided(context: StepContext, search: GuidedSearch, is_kept: IsKept) -> list[Floats]:
    """Return the paths (N, 2) that a search finds with guides for the connectivity rule."""
    problem, history = context.problem, context.history
    rule, count = rule_of(problem), problem.planner.horizon
    no_credit = np.zeros(count)
    if rule.holds_steps:
        masks = _held_patterns(rule, context, count)
        guides = [Guide(problem.constraints.p_min, mask, no_credit) for mask in masks]
        return [path for guide in guides for path in search(guide)]
    none = Guide(0.0, np.zeros(count, dtype=np.bool_), no_credit)
    found = search(none)
    if not found or is_kept(found[0]):
        return found
    # For independent steps, the common level at each step satisfies the rule.
    level = common_level(rule, problem.constraints.p_min, history, count)
    found += search(Guide(level, np.ones(count, dtype=np.bool_), no_credit))
    # Bisection finds the smallest sufficient credit, a Lagrange multiplier.
    _, weight = rule.slopes(np.full(count, UNCONSTRAINED), history)
    weight = weight / max(float(weight.max()), 1e-9)
    low, high = LOWEST_CREDIT, HIGHEST_CREDIT
    most = search(replace(none, credit=high * weight))
    found += most
    if not most or not is_kept(most[0]):
        return found
    for _ in range(CREDIT_HALVINGS):
        middle = float(np.sqrt(low * high))
        paths = search(replace(none, credit=middle * weight))
        found += paths
        low, high = (low, middle) if paths and is_kept(paths[0]) else (middle, high)
    return found


def common_level(rule: Rule, p_min: float, history: History, count: int) -> float:
    """Return the smallest common probability of all steps that satisfies the rule."""
    required = rule.required(p_min, history, count)
    low, high = 0.0, 1.0
    for _ in range(LEVEL_HALVINGS):
        middle = 0.5 * (low + high)
        kept = float(rule.valued(np.full(count, middle), history)) >= required
        low, high = (low, middle) if kept else (middle, high)
    return min(high, 1.0 - LEAST_LEVEL)


def _held_patterns(rule: Rule, context: StepContext, count: int) -> list[Mask]:
    """Return masks (N,) of steps whose connection satisfies the rule: latest, earlier, all."""
    history, asks = context.history, context.problem.constraints.requires_connection
    every = np.ones(count, dtype=np.bool_)
    latest = rule.held(every, history)
    if rule.by_step or not latest.any():
        return [latest & asks]
    last = int(np.argmax(latest))
    found = [latest]
    for first in np.unique(np.linspace(0, last, PATTERNS).astype(np.intp))[:-1].tolist():
        keeps = np.zeros(count, dtype=np.bool_)
        keeps[last + 1 :] = keeps[first] = True
        found.append(rule.held(keeps, history))
    return [*found, every]


def missing(at: StepContext, legs_m: Floats, power: Prediction) -> Floats:
    """Return each path's shortfall (c,) from the connectivity rule; 0 if the rule is satisfied."""
    # For rules on each step, the unit is dB, summed over steps; otherwise it is the number of
    # missing connected steps.
    # Shapes: legs_m (c, N).
    constraints, history = at.problem.constraints, at.history
    rule, shape = rule_of(at.problem, legs_m), legs_m.shape
    if rule.by_step:
        margins = required_margins_db(at.problem, power).reshape(shape)
        every = np.ones(int(legs_m.shape[1]), dtype=np.bool_)
        return np.maximum(-margins, 0.0) @ rule.held(every, history)
    threshold = at.problem.stations[0].threshold_dbm
    chance = connection_probability(power.mean_db, power.deviation_db, threshold).reshape(shape)
    required = rule.required(constraints.p_min, history, shape[1])
    short = np.maximum(required - rule.valued(chance, history), 0.0)
    return short / _value_of_step(rule, at, shape)


def _value_of_step(rule: Rule, at: StepContext, shape: tuple[int, ...]) -> Floats:
    """Return each path's mean increase (c,) of the rule's value per connected step."""
    history = at.history
    gained = rule.valued(np.ones(shape), history) - rule.valued(np.zeros(shape), history)
    return np.maximum(gained / shape[1], 1e-9)


def missing_slope(at: StepContext, batch: LocalPaths) -> Floats:
    """Return gradients (c, N, 2) of the rule's shortfall; zero for a rule on outages."""
    problem, history, power = at.problem, at.history, batch.power
    rule, threshold = rule_of(problem), problem.stations[0].threshold_dbm
    if rule.by_step:
        quantile = bound_quantile(problem.constraints.p_min)
        margin = power.mean_db - quantile * power.deviation_db - threshold
        held = rule.held(np.ones(batch.shape[1], dtype=np.bool_), history)
        missed = ((margin < 0.0).reshape(batch.shape) & held).astype(np.float64)
        return batch.power_slope(-missed, quantile * missed)
    if rule.holds_steps:
        return np.zeros(batch.paths_m.shape)
    chance = connection_probability(power.mean_db, power.deviation_db, threshold)
    achieved, slope = rule.slopes(chance.reshape(batch.shape), history)
    missed = achieved < rule.required(problem.constraints.p_min, history, batch.shape[1])
    score = (power.mean_db - threshold) / power.deviation_db
    density = np.exp(-0.5 * score**2) / (np.sqrt(2.0 * np.pi) * power.deviation_db)
    by_mean = -slope * (missed / _value_of_step(rule, at, batch.shape))[:, None]
    by_mean = by_mean * density.reshape(batch.shape)
    return batch.power_slope(by_mean, -by_mean * score.reshape(batch.shape))
