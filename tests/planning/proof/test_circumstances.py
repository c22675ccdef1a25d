"""What the steps of a run share when they are judged."""

from __future__ import annotations

import numpy as np
from scenes import bad_band, belief_of, small_problem

from planopt.planning.proof.context import verifier_context
from planopt.planning.proof.searches import GoalCosts, GoalGrid, build_goal_grid, goal_costs
from planopt.world.clearance import index_obstacles


def test_the_grid_of_a_run_is_laid_once() -> None:
    """A step that needs the verifier's grid hands it on; costs are those of each step's belief."""
    problem = small_problem()
    index = index_obstacles(problem.workspace)
    laid: list[GoalGrid] = []

    def build() -> GoalGrid:
        laid.append(build_goal_grid(problem, index))
        return laid[-1]

    def cost(low_m: float, grid: GoalGrid | None) -> tuple[GoalGrid | None, GoalCosts | None]:
        posteriors = belief_of(problem, bad_band(low_m, low_m + 4.0)).posteriors
        under = verifier_context(problem, index, posteriors, np.zeros(2), goal_grid=grid)
        assert under.laid_grid is grid

        def value(there: GoalGrid) -> GoalCosts:
            return goal_costs(
                there,
                lambda places: (np.where(places[:, 0] > low_m, 1.0, 0.0), places[:, 0] - low_m),
                10.0,
            )

        _, costs = under.goal_costs(build, value)
        return under.laid_grid, costs

    grid, first = cost(10.0, None)
    again, second = cost(20.0, grid)
    assert len(laid) == 1 and grid is again is laid[0]
    assert first is not None and second is not None
    assert first.best_margin_db > second.best_margin_db
