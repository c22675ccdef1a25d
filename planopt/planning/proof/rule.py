"""Context of a verification, and base classes of connectivity rules.

The verifier predicts power from all measurements, the search from a nearby subset. A rule bounds a
function of a plan's connection probabilities.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.channel.connectivity_law import ConnectivityLaw, UncertainParameters
from planopt.channel.kriging import (
    NEIGHBOURS_BEYOND,
    Prediction,
    connection_probability,
    predict,
    predict_nearby,
)
from planopt.channel.parameter_uncertainty import marginalise
from planopt.channel.posterior import EXACT_LIMIT, ChannelPosterior
from planopt.errors import InputError
from planopt.parts import calling, class_name, returned
from planopt.planning.certificate import RuleResult
from planopt.planning.plan import BEGINNING, History
from planopt.planning.proof.searches import GoalCosts, GoalGrid
from planopt.problems.objective import RULES
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex
from planopt.world.motion import NOTHING_MOVES, MovingDiscs, predicted_discs

if TYPE_CHECKING:
    # Type checkers reject a cached property for a protocol's property.
    cached_property = property
else:
    from functools import cached_property

SEARCH_EXACT_LIMIT = 1000
"""Maximum number of measurements for which searches use the full posterior."""
SEARCH_NEIGHBOURS = 128
"""Number of nearest measurements per position for larger logs, within 0.01 dB."""
SEARCH_ERROR_DB = 2e-3  # Margin that a search requires if it uses nearest measurements only


def is_search_exact(posterior: ChannelPosterior) -> bool:
    """Return whether searches use all measurements, as the verifier does."""
    return len(posterior.measurements) <= SEARCH_EXACT_LIMIT


def certified_prediction(law: ConnectivityLaw, positions_m: Floats) -> tuple[Prediction, str]:
    """Return the verifier's power prediction at positions (n, 2), and the posterior's name."""
    most = max(len(station.measurements) for station in law.posteriors)
    kind = "exact" if most <= EXACT_LIMIT else f"neighbours:{NEIGHBOURS_BEYOND}"
    return law.power(positions_m, _certified_power), kind


def _certified_power(posterior: ChannelPosterior, positions_m: Floats) -> Prediction:
    if len(posterior.measurements) <= EXACT_LIMIT:
        return predict(posterior, positions_m)
    return predict_nearby(posterior, positions_m, NEIGHBOURS_BEYOND)


def search_prediction(law: ConnectivityLaw, positions_m: Floats) -> Prediction:
    """Return the power prediction that searches use at positions (n, 2)."""
    return law.power(positions_m, search_power)


def search_power(posterior: ChannelPosterior, positions_m: Floats) -> Prediction:
    """Return one station's power prediction that searches use at positions (n, 2)."""
    if is_search_exact(posterior):
        return predict(posterior, positions_m)
    return predict_nearby(posterior, positions_m, SEARCH_NEIGHBOURS)


def stations_law(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> ConnectivityLaw:
    """Return the probability model of a connection to any of the stations."""
    thresholds = tuple(radio.threshold_dbm for radio in problem.stations)
    return ConnectivityLaw(tuple(posteriors), thresholds, problem.constraints.p_min)


def uncertain_law(
    problem: Problem, posteriors: Sequence[ChannelPosterior]
) -> ConnectivityLaw | None:
    """Return the model with uncertain channel parameters, if the problem requires it; else None."""
    if problem.constraints.rule.parameter_uncertainty == "path_loss":
        return None
    plain = stations_law(problem, posteriors)
    (posterior,) = plain.posteriors
    marginal = marginalise(posterior.parameters, posterior.measurements)
    return UncertainParameters(plain.posteriors, plain.thresholds_dbm, plain.p_min, marginal)


def connectivity_law(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> ConnectivityLaw:
    """Return the probability model that the chance constraint is based on."""
    return uncertain_law(problem, posteriors) or stations_law(problem, posteriors)


@dataclass(frozen=True, eq=False)
class VerifierContext:
    """Data for the verification of one robot's plan: problem, state and belief at one step."""

    problem: Problem  # Problem with this robot alone
    index: ObstacleIndex  # Index of the problem's obstacles
    posteriors: tuple[ChannelPosterior, ...]  # Belief of each station's channel
    state: Floats  # (s,) the robot's state, its position first
    moving: MovingDiscs = NOTHING_MOVES  # Moving obstacles and other robots during the steps
    history: History = BEGINNING  # Executed steps, for rules over the whole run
    uncertain: ConnectivityLaw | None = None  # Model with uncertain parameters, if required
    # The verifier's grid of paths to the goal; None if it is built on demand
    goal_grid: GoalGrid | None = None
    _goal_costs: list[tuple[GoalGrid, GoalCosts]] = field(
        default_factory=list[tuple[GoalGrid, GoalCosts]], init=False, repr=False
    )
    _best_margins: dict[tuple[int, ...], tuple[float, ...]] = field(
        default_factory=dict[tuple[int, ...], tuple[float, ...]], init=False, repr=False
    )

    @property
    def posterior(self) -> ChannelPosterior:
        """Belief of the first station's channel."""
        return self.posteriors[0]

    @cached_property
    def law(self) -> ConnectivityLaw:
        """Probability model of connection."""
        law = self.uncertain or stations_law(self.problem, self.posteriors)
        # Packets prove nothing if shadowing varies with time.
        changes = any(math.isfinite(each.parameters.forgetting_s) for each in law.posteriors)
        return law if changes else replace(law, proven=self.history.connected)

    @property
    def position_m(self) -> Floats:
        """``(2,)`` position of the robot."""
        return self.state[:2]

    @property
    def laid_grid(self) -> GoalGrid | None:
        """Grid of shortest paths to the goal, shared by all steps; None before it is built."""
        return self._goal_costs[0][0] if self._goal_costs else self.goal_grid

    def goal_costs(
        self, build: Callable[[], GoalGrid], value: Callable[[GoalGrid], GoalCosts]
    ) -> tuple[GoalGrid, GoalCosts]:
        """Return the verifier's grid and its costs for the belief, cached for all candidates."""
        if not self._goal_costs:
            grid = self.goal_grid or build()
            self._goal_costs.append((grid, value(grid)))
        return self._goal_costs[0]

    def best_margins(
        self, steps: tuple[int, ...], search: Callable[[], tuple[float, ...]]
    ) -> tuple[float, ...]:
        """Return the best reachable margins at `steps` from `search`, cached for all candidates."""
        if steps not in self._best_margins:
            self._best_margins[steps] = search()
        return self._best_margins[steps]


def verifier_context(
    problem: Problem,
    index: ObstacleIndex,
    posteriors: Sequence[ChannelPosterior],
    state: Floats,
    history: History = BEGINNING,
    moving: MovingDiscs | None = None,  # None: moving obstacles of the problem
    goal_grid: GoalGrid | None = None,
) -> VerifierContext:
    """Return the verification context of the step after `history`."""
    if moving is None:
        moving = obstacles_ahead(problem, history.steps)
    uncertain = uncertain_law(problem, posteriors)
    return VerifierContext(
        problem, index, tuple(posteriors), state, moving, history, uncertain, goal_grid
    )


def steps_ahead(problem: Problem) -> int:
    """Return the number of steps of obstacle predictions: horizon plus longest braking."""
    settings = problem.planner
    braking = [robot.dynamics.longest_stop_steps(settings.step_s) for robot in problem.robots]
    return settings.horizon + max(braking)


def obstacles_ahead(problem: Problem, driven: int) -> MovingDiscs:
    """Return the moving obstacles predicted for the next steps, after `driven` steps of a run."""
    # Predictions are renewed at every step; their uncertainty grows over the steps ahead.
    if not problem.workspace.moving:
        return NOTHING_MOVES
    settings = problem.planner
    return predicted_discs(
        problem.workspace.moving,
        driven * settings.step_s,
        settings.step_s,
        steps_ahead(problem),
        problem.constraints.clearance_m,
    )


BySlack = Callable[[float], RuleResult]
"""Function that maps slack in dB, which lowers the threshold, to the result of a path."""
PROBE = 1e-4  # Probability increment of the finite differences
ROUNDING = 1e-9  # Tolerance of range and monotonicity checks
HALVINGS = 22  # Number of bisections of the slack, from 500 dB to about a ten-thousandth of a dB


@dataclass(frozen=True, eq=False)
class PathCase:
    """Path to be verified by a connectivity rule over all its steps."""

    context: VerifierContext
    positions_m: Floats  # (N + 1, 2) positions, the robot's current one first
    power: Prediction  # Predicted power after each of the N steps

    @property
    def problem(self) -> Problem:
        """Problem of the verification context."""
        return self.context.problem

    @property
    def history(self) -> History:
        """Steps executed so far."""
        return self.context.history

    def probability(self, slack_db: float) -> Floats:
        """Return P(connected) after each step (N,) for a threshold lowered by `slack_db`."""
        if len(self.context.posteriors) > 1 and slack_db > 0.0:
            return self.context.law.probability(self.positions_m[1:], slack_db)
        threshold = self.problem.stations[0].threshold_dbm - slack_db
        return connection_probability(self.power.mean_db, self.power.deviation_db, threshold)

    @property
    def rule(self) -> Rule:
        """Connectivity rule for the path's step lengths."""
        return rule_of(self.problem, np.linalg.norm(np.diff(self.positions_m, axis=0), axis=1))


class Rule(ABC):
    """Base class of connectivity rules."""

    kind: ClassVar[str]
    unit: ClassVar[str] = "probability"
    method: ClassVar[str] = "of the probabilities"
    keys: ClassVar[tuple[str, ...]] = ()  # Keys of [constraints] specific to this rule
    keys_required: ClassVar[int] = 0  # Exact number of required keys; 0 for any
    by_step: ClassVar[bool] = False  # Whether each step is verified individually
    # Whether the planner constrains single steps by p_min, rather than a sum of probabilities
    holds_steps: ClassVar[bool] = False
    # Whether results report minus the value, which then has an upper bound
    greatest: ClassVar[bool] = False
    uses_p_min: ClassVar[bool] = True  # Whether p_min = 0 disables the rule
    is_joint: ClassVar[bool] = False  # Whether a p_min bounds a joint probability of the steps
    subject: ClassVar[str] = ""  # Name of the value in messages
    metric: ClassVar[str] = ""  # Name of the metric of a run; empty if there is none

    @classmethod
    def of(cls, problem: Problem, legs_m: Floats) -> Rule:
        """Return the problem's rule for steps of lengths `legs_m` ``(..., N)``."""
        return cls(**dict(problem.constraints.rule.settings))

    @classmethod
    def keys_fault(cls, given: Collection[str]) -> str | None:
        """Return text on missing or superfluous keys of [constraints]; None if there are none."""
        missing = [key for key in cls.keys if key not in given]
        if not cls.keys_required or len(cls.keys) - len(missing) == cls.keys_required:
            return None
        one = cls.keys_required == 1
        key = cls.keys[-1] if one else missing[0]
        words = f"one of {' and '.join(cls.keys)}" if one else key
        return f'{words} for connectivity = "{cls.kind}": write {key} = 10.0'

    @classmethod
    def check(cls, problem: Problem) -> None:
        """Raise an InputError if the rule is not applicable to a problem."""
        del problem  # most rules suit every problem

    @abstractmethod
    def achieved(self, probability: Floats, history: History) -> float | Floats:
        """Return the value ``(...)`` of plans with connection probabilities ``(..., N)``."""

    def required(self, p_min: float, history: History, count: int) -> float:
        """Return the value that a plan of `count` steps must reach."""
        return p_min

    def counted(self, history: History, count: int) -> Mask:
        """Return a mask ``(count,)`` of the steps that must each satisfy p_min."""
        return np.zeros(count, dtype=np.bool_)

    def held(self, keeps: Mask, history: History) -> Mask:
        """Return a mask (N,) of steps, preferably in `keeps`, whose connection meets the rule."""
        raise AssertionError("a rule that holds no steps")

    def valued(self, probability: Floats, history: History) -> Floats:
        """Return :meth:`achieved` as an array ``(...)``."""
        return np.asarray(self.achieved(probability, history), dtype=np.float64)

    def slopes(self, probability: Floats, history: History) -> tuple[Floats, Floats]:
        """Return the values (...) of plans, and gradients w.r.t. their probabilities (..., N)."""
        # Differences point towards 0.5, so that probabilities stay between 0 and 1.
        probe = np.where(probability > 0.5, -PROBE, PROBE)
        probed = probability[..., None, :] + np.eye(probability.shape[-1]) * probe[..., None]
        value, changed = self.valued(probability, history), self.valued(probed, history)
        slope = (changed - value[..., None]) / probe
        size = max(1.0, float(np.abs(changed).max(initial=0.0)))
        if (slope * PROBE < -ROUNDING * size).any():
            worst = int(np.argmin(slope))
            raise InputError(
                f"{class_name(self)}.achieved decreases if the probability of connection at "
                f"step {worst % slope.shape[-1] + 1} increases (slope {slope.flat[worst]:.3g} "
                f"at {probability.flat[worst]:.3g})",
                key="constraints.connectivity",
                remedy="return a value that never decreases with a probability of connection, such "
                "as 1 minus a probability of outage",
            )
        return value, np.maximum(slope, 0.0)

    def correlates(self, p_min: float) -> bool:
        """Return whether the verifier computes a joint probability of the steps."""
        return self.is_joint and p_min > 0.0

    def by_slack(self, case: PathCase) -> BySlack:
        """Return a function that maps slack to the verified result of a path."""
        p_min, count = case.problem.constraints.p_min, len(case.positions_m) - 1
        sign = -1.0 if self.greatest else 1.0
        required = sign * self.required(p_min, case.history, count)

        def result(slack_db: float) -> RuleResult:
            achieved = sign * float(self.valued(case.probability(slack_db), case.history))
            return RuleResult(self.kind, achieved, required, self.unit, self.method)

        return result

    def missed_words(self, result: RuleResult) -> tuple[str, str]:
        """Return text on the missed value, and the key of the required value."""
        limit = next((key for key in self.keys if key.endswith(f"_max_{result.unit}")), None)
        return self.subject, "constraints.p_min" if limit is None else f"constraints.{limit}"

    def run_metrics(self, problem: Problem, connected: Sequence[Mask]) -> dict[str, float]:
        """Return the worst robot's metric by name, from a connection mask (n,) per robot."""
        each = [self.over_run(problem, now) for now in connected]
        return {self.metric: (max if self.greatest else min)(each)} if self.metric else {}

    def over_run(self, problem: Problem, connected: Mask) -> float:
        """Return one robot's metric from its connection mask (n,); NaN without steps."""
        return float(connected.mean()) if connected.size else float("nan")


def rule_of(problem: Problem, legs_m: Floats | None = None) -> Rule:
    """Return the problem's rule for step lengths ``(..., N)``; default: the maximum step."""
    kind: type[Rule] = problem.constraints.rule.kind
    full = np.full(problem.planner.horizon, problem.step_length_m)
    return kind.of(problem, full if legs_m is None else legs_m)


def whole_plan_result(case: PathCase) -> RuleResult:
    """Return a rule's result for a whole path, with the smallest slack that satisfies the rule."""
    # Smallest sufficient threshold reduction, or zero if none up to `slack_max_db` is.
    result_at = case.rule.by_slack(case)
    hard = result_at(0.0)
    limit = case.problem.constraints.rule.slack_max_db or 0.0
    if limit == 0.0 or not hard.is_missed or result_at(limit).is_missed:
        return hard
    low, high = 0.0, limit
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if result_at(middle).is_missed else (low, middle)
    return replace(hard, slack_db=high)


def rule_reasons(problem: Problem, result: RuleResult) -> list[str]:
    """Return the reasons (at most one) why a path violates its rule beyond the slack."""
    if not result.is_missed or result.slack_db > 0.0:
        return []
    words, key = rule_of(problem).missed_words(result)
    unit = "" if result.unit == "probability" else f" {result.unit}"
    limit = problem.constraints.rule.slack_max_db
    return [
        f"{words} is {result.achieved:.4g}{unit} "
        f"({result.method}), {key} requires {result.required:.4g}{unit}"
        + (f", also with constraints.slack_max_db {limit:g}" if limit else "")
    ]


KEY = "constraints.connectivity"


class OwnRule(Rule):
    """Base class of a user-defined rule: a frozen dataclass with a ``kind`` and a value.

    The fields of a subclass, all numbers, are the keys of ``constraints.settings``. The verifier
    evaluates :meth:`achieved`; planners use its gradient. The value must not decrease if a
    probability increases.

    Attributes
    ----------
    kind
        Value of the key ``constraints.connectivity``.
    unit
        Unit of the value; the default ``"probability"`` requires values from 0 to 1.
    uses_p_min
        Whether the value must reach p_min; otherwise it must reach :meth:`requirement`.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from typing import ClassVar
    >>> import numpy as np
    >>> from planopt.extend import OwnRule
    >>> @dataclass(frozen=True)
    ... class Soon(OwnRule):
    ...     "Probability of a connection in the first steps, if steps are independent."
    ...
    ...     kind: ClassVar[str] = "soon"
    ...     steps: float = 5
    ...
    ...     def achieved(self, probability, history):
    ...         return 1.0 - np.prod(1.0 - probability[..., : int(self.steps)], axis=-1)
    >>> Soon(2).achieved(np.array([0.5, 0.5, 0.9]), None)
    np.float64(0.75)
    """

    kind: ClassVar[str]

    def __init_subclass__(cls, **keywords: Any) -> None:
        """Register the rule for problems in this process and in worker processes of studies."""
        super().__init_subclass__(**keywords)
        if not cls.uses_p_min and cls.requirement is OwnRule.requirement:
            raise InputError(
                f"the class {class_name(cls)} sets uses_p_min = False but does not define the "
                "method requirement",
                key="requirement",
                remedy="define requirement(self, p_min), or leave uses_p_min out",
            )
        if "kind" in cls.__dict__:
            RULES.add(cls.kind, cls)

    @abstractmethod
    def achieved(self, probability: Floats, history: History) -> float | Floats:
        """Return the value that the rule assigns to plans; larger values are better.

        Parameters
        ----------
        probability
            ``(..., N)`` probabilities of connection after each step, for one or many plans.
        history
            Steps executed before the plan.
        """

    def requirement(self, p_min: float) -> float:
        """Return the value that a plan must reach."""
        return p_min

    def valued(self, probability: Floats, history: History) -> Floats:
        """Return :meth:`achieved` as a validated array ``(...)``."""
        words = f"{self._number} per plan: the shape of `probability` (..., N) without N"
        with calling(self, "achieved", key=KEY, remedy=f"return {words}"):
            found = self.achieved(probability, history)
        shape = probability.shape[:-1]
        return self._within(
            "achieved", returned(self, "achieved", found, shape, words=words, key=KEY), words
        )

    def required(self, p_min: float, history: History, count: int) -> float:
        """Return :meth:`requirement` as a validated number."""
        words = self._number
        with calling(self, "requirement", key=KEY, remedy=f"return {words}"):
            found = self.requirement(p_min)
        number = returned(self, "requirement", found, (), words=words, key=KEY)
        return float(self._within("requirement", number, words))

    @property
    def _number(self) -> str:
        """Return a description of valid values for messages."""
        is_probability = self.unit == OwnRule.unit
        return "one number from 0 to 1" if is_probability else "one finite number"

    def _within(self, method: str, values: Floats, words: str) -> Floats:
        """Return a method's values; raise an InputError if probabilities are outside [0, 1]."""
        if self.unit != OwnRule.unit:
            return values
        inside = np.clip(values, 0.0, 1.0)
        if (np.abs(values - inside) > ROUNDING).any():
            worst = values.flat[int(np.argmax(np.abs(values - inside)))]
            raise InputError(
                f"{class_name(self)}.{method} returned {worst:.6g}, which is not a {self.unit}",
                key=KEY,
                remedy=f'return {words}, or set the attribute unit, e.g. unit = "steps"',
            )
        return inside

    def by_slack(self, case: PathCase) -> BySlack:
        """Return a function that maps slack to the result, after a check of monotonicity."""
        self.slopes(case.probability(0.0), case.history)
        return super().by_slack(case)

    def missed_words(self, result: RuleResult) -> tuple[str, str]:
        """Return text with the name of the rule, and the key of its bound."""
        key = "constraints.p_min" if self.uses_p_min else "the rule"
        return f"what constraints.connectivity {self.kind!r} counts", key
