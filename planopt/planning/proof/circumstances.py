"""The context that a plan is made and verified in, besides the problem and the posterior.

Moving obstacles are predicted over a plan's steps, and while robots brake after them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.planning.history import BEGINNING, History
from planopt.planning.proof.goal_paths import GoalCosts, GoalGrid
from planopt.planning.proof.predictions import Broad, broad_prediction
from planopt.problems.problem import Problem
from planopt.world.moving_obstacle import NOTHING_MOVES, MovingDiscs, predicted_discs

_Asked = tuple[bytes, tuple[int, ...]]
"""A state, and steps."""


@dataclass(frozen=True, eq=False)
class Circumstances:
    """The circumstances that a plan is made and judged under.

    Attributes
    ----------
    moving
        What moves during the steps.
    history
        What has happened on the run before: rules over the whole run count it.
    broad
        What the bound rests on where it is not the posterior alone: all parameters are to count as
        uncertain, or there are several stations.
    goal_grid
        Where the verifier searches for cheaper paths to the goal; None where it lays the grid when
        it needs it.
    """

    moving: MovingDiscs = NOTHING_MOVES
    history: History = BEGINNING
    broad: Broad | None = None
    goal_grid: GoalGrid | None = None
    _goal_costs: list[tuple[ChannelPosterior, GoalGrid, GoalCosts]] = field(
        default_factory=list[tuple[ChannelPosterior, GoalGrid, GoalCosts]], init=False, repr=False
    )
    _best_margins: list[tuple[ChannelPosterior, _Asked, tuple[float, ...]]] = field(
        default_factory=list[tuple[ChannelPosterior, _Asked, tuple[float, ...]]],
        init=False,
        repr=False,
    )

    @property
    def laid_grid(self) -> GoalGrid | None:
        """The grid that was needed so far; the same for every step of a robot's run."""
        return self._goal_costs[0][1] if self._goal_costs else self.goal_grid

    def goal_costs(
        self,
        posterior: ChannelPosterior,
        build: Callable[[], GoalGrid],
        value: Callable[[GoalGrid], GoalCosts],
    ) -> tuple[GoalGrid, GoalCosts]:
        """The verifier's grid and its costs by what is believed, made once for all candidates."""
        kept = self._goal_costs
        if not kept or kept[0][0] is not posterior:
            grid = self.goal_grid or build()
            kept[:] = [(posterior, grid, value(grid))]
        return kept[0][1:]

    def best_margins(
        self,
        posterior: ChannelPosterior,
        state: NDArray[np.float64],
        steps: tuple[int, ...],
        search: Callable[[], tuple[float, ...]],
    ) -> tuple[float, ...]:
        """Return what the search within reach of a state finds by some steps, made once.

        Candidates that miss the bound at the same steps all ask for it.
        """
        asked = state.tobytes(), steps
        for other, key, found in self._best_margins:
            if other is posterior and key == asked:
                return found
        found = search()
        self._best_margins.append((posterior, asked, found))
        return found


def circumstances_of(
    problem: Problem,
    posteriors: Sequence[ChannelPosterior],
    history: History = BEGINNING,
    moving: MovingDiscs | None = None,
    goal_grid: GoalGrid | None = None,
) -> Circumstances:
    """The circumstances of the step after `history`.

    Parameters
    ----------
    problem, posteriors
        What is asked, and what is believed of each station's channel.
    history
        What has happened before.
    moving
        What moves; None for the problem's moving obstacles alone.
    goal_grid
        Of the problem, where it is at hand.
    """
    if moving is None:
        moving = obstacles_ahead(problem, history.steps)
    return Circumstances(moving, history, broad_prediction(problem, posteriors), goal_grid)


def steps_ahead(problem: Problem) -> int:
    """Steps for which it counts where everything is: planned ones, then the longest braking."""
    settings = problem.planner
    braking = [
        robot.dynamics.longest_stop_steps(settings.step_s)
        for robot in problem.robots
        if robot.dynamics is not None
    ]
    return settings.horizon + max(braking, default=0)


def obstacles_ahead(problem: Problem, driven: int) -> MovingDiscs:
    """Return the predicted discs over the steps ahead, after `driven` steps of a run.

    They are predicted anew at every step: what is not known of their way counts from then on.
    """
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
