"""Objective value of a path: the weighted sum of terms, or the cost to a goal."""

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.channel.kriging import Prediction, bound_margin_db, connection_probability
from planopt.errors import InputError
from planopt.objectives.terms.term import Term
from planopt.parts import calling, returned
from planopt.planning.certificate import RuleResult, required_margins_db
from planopt.planning.plan import Pivot
from planopt.planning.proof.rule import PathCase, rule_of, whole_plan_result
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB
from planopt.planning.values.context import StepContext
from planopt.problems.problem import Problem
from planopt.problems.reach_cost import charged_length_m, outage_share, rate_s_m, steps_cost_s
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


SHARE_IN_DB = 100.0
"""Cost in dB of a relative shortfall of one, for a rule over a whole plan."""


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
BRAKING_PLACES = 9
"""Number of positions on the braking path at which outage is evaluated."""


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
        """Cost per metre beyond the horizon."""
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
        """Return the pivot for the cost-to-go of a path (N, 2)."""
        end = path_m[-1] if drive is None else resting_places_m(drive)[-1]
        return None if self.ahead is None else self.ahead(end)

    @property
    def threshold_dbm(self) -> float:
        """Power threshold of connection, minus the allowed slack."""
        slack_db = self.problem.constraints.rule.slack_max_db or 0.0
        return self.problem.stations[0].threshold_dbm - slack_db

    def _charged_m(self, places_m: Floats) -> float:
        """Return the length out of contact of a path (N + 1, 2), in metres."""
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
        """Return the penalised share of a metre at the robot, and its maximum along a path."""
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
