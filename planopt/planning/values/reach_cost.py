"""Cost of a path to a goal, including the route beyond the horizon."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, bound_margin_db, connection_probability
from planopt.objectives.reach import charged_length_m, cost_rate_s_m, outage_share, path_cost_s
from planopt.planning.plan import Pivot
from planopt.problems.problem import Problem
from planopt.robots.dynamics import Drive

BRAKING_PLACES = 9
"""Number of positions on the braking path at which the outage price is evaluated."""


@dataclass(frozen=True)
class ReachCost:
    """Cost of paths to a goal in one planning step."""

    problem: Problem  # Problem with a goal
    position_m: NDArray[np.float64]  # (2,) position of the robot
    # Predicted power at positions (n, 2), which decides where a path violates the bound
    power: Callable[[NDArray[np.float64]], Prediction]
    # Function from a path's end (2,) to the pivot of the remaining route; None if no cost-to-go is
    # charged
    ahead: Callable[[NDArray[np.float64]], Pivot] | None = None
    # Whether outage is priced; False for a robot that has wandered and takes the shortest
    # path
    priced: bool = True

    @property
    def outage_price(self) -> float:
        """Return the price of a metre out of contact."""
        return self.problem.reach.outage_price if self.priced else 0.0

    @property
    def rate_s_m(self) -> float:
        """Cost per metre beyond the horizon."""
        return cost_rate_s_m(
            self.problem.reach.effort_weight_s2_m2, self.problem.robots[0].speed_max_m_s
        )

    def __call__(self, path_m: NDArray[np.float64], drive: Drive | None = None) -> float:
        """Return the cost of a path (N, 2) in seconds, including outage price and cost-to-go."""
        problem = self.problem
        resting = None if drive is None else resting_places_m(drive)
        places = np.vstack([self.position_m, path_m])
        cost = path_cost_s(
            places,
            np.asarray(problem.goal_m),
            problem.constraints.goal_radius_m,
            problem.planner.step_s,
            problem.reach.effort_weight_s2_m2,
            resting,
        )
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

    def pivot_of(self, path_m: NDArray[np.float64], drive: Drive | None = None) -> Pivot | None:
        """Return the pivot used in the cost-to-go of a path (N, 2)."""
        end = path_m[-1] if drive is None else resting_places_m(drive)[-1]
        return None if self.ahead is None else self.ahead(end)

    @property
    def threshold_dbm(self) -> float:
        """Power threshold of connection, minus the allowed slack."""
        slack_db = self.problem.constraints.rule.slack_max_db or 0.0
        return self.problem.stations[0].threshold_dbm - slack_db

    def _charged_m(self, places_m: NDArray[np.float64]) -> float:
        """Return the length of a path (N + 1, 2) to which the outage price applies, in metres."""
        lengths = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
        return charged_length_m(lengths, self._outage_share(places_m))

    def _outage_share(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        power, threshold = self.power(places_m), self.threshold_dbm
        mean, deviation = power.mean_db, power.deviation_db
        chance = connection_probability(mean, deviation, threshold)
        return outage_share(chance, self._is_below(power), self._everywhere)

    def metre_costs(self, path_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the cost per metre at the robot and along a path (N, 2); (N + 1,)."""
        places = np.vstack([self.position_m, path_m])
        return 1.0 + self.outage_price * self._outage_share(places)

    def outage_charges(self, path_m: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Return the charged fraction of a metre at the robot, and along a path (N, 2).

        The second value, (N,), assumes that connection is impossible.
        """
        below = self._is_below(self.power(path_m))
        certain = outage_share(np.zeros(len(path_m)), below, self._everywhere)
        return float(self._outage_share(self.position_m[None])[0]), certain

    @property
    def _everywhere(self) -> bool:
        return self.problem.reach.charges_everywhere

    def _is_below(self, power: Prediction) -> NDArray[np.bool_]:
        margin = bound_margin_db(
            power.mean_db, power.deviation_db, self.threshold_dbm, self.problem.constraints.p_min
        )
        return margin < 0.0


def resting_places_m(drive: Drive) -> NDArray[np.float64]:
    """Return the resting position after braking from each state of a drive; (N + 1, 2)."""
    return np.column_stack(drive.dynamics.resting_place(tuple(drive.states.T)))
