"""Context of a verification, and the power predictions of verifier and search.

The verifier uses all measurements, the search a nearby subset.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from planopt.arrays import Floats
from planopt.channel.connectivity_law import ConnectivityLaw, UncertainParameters
from planopt.channel.kriging import NEIGHBOURS_BEYOND, predict, predict_nearby
from planopt.channel.parameter_uncertainty import marginalise
from planopt.channel.posterior import EXACT_LIMIT, ChannelPosterior
from planopt.channel.prediction import Prediction
from planopt.planning.plan import BEGINNING, History
from planopt.planning.proof.searches import GoalCosts, GoalGrid
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex
from planopt.world.moving_discs import NOTHING_MOVES, MovingDiscs, predicted_discs

SEARCH_EXACT_LIMIT = 1000
"""Maximum number of measurements for which searches use the full posterior."""
SEARCH_NEIGHBOURS = 128
"""Number of nearest measurements per position for larger logs, within 0.01 dB."""
SEARCH_ERROR_DB = 2e-3
"""Margin that a search requires if it uses nearest measurements only."""


def is_search_exact(posterior: ChannelPosterior) -> bool:
    """Return whether searches use all measurements, as the verifier does."""
    return len(posterior.measurements) <= SEARCH_EXACT_LIMIT


def certified_prediction(law: ConnectivityLaw, positions_m: Floats) -> tuple[Prediction, str]:
    """Return the verifier's power prediction at positions (n, 2), and its posterior's name."""
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

    @property
    def law(self) -> ConnectivityLaw:
        """Probability model of connection."""
        return self.uncertain or stations_law(self.problem, self.posteriors)

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
