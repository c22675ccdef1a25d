"""How well a map could be known if measurements were taken at will: what planning can still win.

``python benchmarks/bench_map_places.py fig3 --first-seed 100 --seeds 5`` drives the problem, and
then looks for as many places as the run measured, anywhere in the workspace, in whatever order and
however far apart, that leave least variance after the same first measurements. The channel's
parameters have to be known. The deviation is that of path loss and shadowing, its mean square over
a grid of `CELLS` squared places outside obstacles; the multipath of places that nobody has measured
comes on top of it.

The places are those of the best of several descents (L-BFGS-B with the exact gradient), one of them
from the run's own places. That is a local optimum each, and no proof that there are no better ones.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from planopt import Problem, load
from planopt.channel import ChannelParameters
from planopt.channel.calibration import FEWEST_GROUPS
from planopt.planning.initial_data import prepare
from planopt.planning.solve import simulate
from planopt.studies.comparison import mean_interval
from planopt.world import clearance_m, index_obstacles

CELLS = 40
"""Places of the grid along either side."""

DESCENTS = 3
"""Descents besides the one from the run's own places: one from a regular grid, others at random."""

STEPS = 300
"""Iterations of a descent at most."""


@dataclass(frozen=True)
class Known:
    """How well a map is known, dB.

    Attributes
    ----------
    driven_db, at_will_db
        Deviation of path loss and shadowing after the run, and after as many measurements at will.
    multipath_std_db
        What multipath adds.
    """

    driven_db: float
    at_will_db: float
    multipath_std_db: float


class LeftVariance:
    """Mean variance over a grid after measurements at places, and its gradient by some of them.

    Parameters
    ----------
    parameters
        Of the channel, path loss known.
    grid_m
        ``(g, 2)``.
    first_m
        ``(n, 2)`` measured anyhow.
    """

    def __init__(
        self,
        parameters: ChannelParameters,
        grid_m: NDArray[np.float64],
        first_m: NDArray[np.float64],
    ) -> None:
        self._parameters, self._grid, self._first = parameters, grid_m, first_m

    def __call__(self, flat: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """The variance in dB^2, and its gradient ``(2 m,)`` by the places, flat."""
        shadowing = self._parameters.shadow_std_db**2
        range_m = self._parameters.decorrelation_m
        own = flat.reshape(-1, 2)
        places = np.vstack([self._first, own])
        apart = cdist(places, places)
        among = shadowing * np.exp(-apart / range_m)
        away = cdist(places, self._grid)
        across = shadowing * np.exp(-away / range_m)
        noise = self._parameters.multipath_std_db**2
        told = np.linalg.solve(among + noise * np.eye(len(places)), across)
        count, first = len(self._grid), len(self._first)
        left = shadowing - float((across * told).sum()) / count
        # d left = (tr(A' dC A) - 2 tr(A' dk)) / g with A = C^-1 k; both slopes point along offsets.
        with np.errstate(divide="ignore", invalid="ignore"):
            pull = 2.0 / count * told * across / (range_m * away)
            push = 2.0 / count * (told @ told.T) * among / (range_m * apart)
        pull, push = (np.where(np.isfinite(each), each, 0.0)[first:] for each in (pull, push))
        slope = pull.sum(axis=1)[:, None] * own - pull @ self._grid
        slope -= push.sum(axis=1)[:, None] * own - push @ places
        return left, slope.ravel()


def best_places(
    problem: Problem, left: LeftVariance, driven_m: NDArray[np.float64], seed: int
) -> float:
    """The least mean variance found, dB^2, for as many places as were driven to."""
    low, high = np.array(problem.workspace.bounds_m).reshape(2, 2)
    generator = np.random.default_rng(seed)
    count = len(driven_m)
    side = int(np.ceil(np.sqrt(count)))
    shares = (np.arange(side) + 0.5) / side
    regular = np.stack(np.meshgrid(shares, shares), axis=-1).reshape(-1, 2)
    drawn = [generator.random((count, 2)) for _ in range(DESCENTS - 1)]
    begins = [driven_m, *(low + (high - low) * each for each in (regular[:count], *drawn))]
    limits = np.tile(np.stack([low, high], axis=1), (count, 1))
    found = (
        minimize(
            left,
            each.ravel(),
            jac=True,
            method="L-BFGS-B",
            bounds=limits,
            options={"maxiter": STEPS},
        )
        for each in begins
    )
    return min(float(each.fun) for each in found)


def known(problem: Problem, seed: int) -> Known:
    """Drive the problem, and place its measurements anew."""
    prepared = prepare(problem, seed)
    run = simulate(problem, seed=seed, prepared=prepared)
    posterior = run.beliefs[0].posterior
    measured = posterior.measurements.positions_m
    first = len(prepared.belief.posterior.measurements)
    low, high = np.array(problem.workspace.bounds_m).reshape(2, 2)
    shares = (np.arange(CELLS) + 0.5) / CELLS
    grid = low + (high - low) * np.stack(np.meshgrid(shares, shares), axis=-1).reshape(-1, 2)
    grid = grid[clearance_m(index_obstacles(problem.workspace), grid) > 0.0]
    left = LeftVariance(posterior.parameters, grid, measured[:first])
    driven = left(measured[first:].ravel())[0]
    at_will = best_places(problem, left, measured[first:], seed)
    return Known(
        float(np.sqrt(driven)), float(np.sqrt(at_will)), posterior.parameters.multipath_std_db
    )


def test_variance_is_that_of_the_belief_and_its_slope_fits() -> None:
    """Against the posterior that planopt conditions, and against differences."""
    posterior = prepare(load("fig3"), 0).belief.posterior
    measured, parameters = posterior.measurements.positions_m, posterior.parameters
    grid = np.random.default_rng(0).uniform(0.0, 60.0, (50, 2))
    left, own = LeftVariance(parameters, grid, measured[:10]), measured[10:].ravel()
    predicted = posterior.predict(grid).deviation_db ** 2 - parameters.multipath_std_db**2
    variance, slope = left(own)
    np.testing.assert_allclose(variance, predicted.mean(), rtol=1e-9)
    for step, along in zip(1e-4 * np.eye(len(own)), slope, strict=True):
        difference = (left(own + step)[0] - left(own - step)[0]) / 2e-4
        np.testing.assert_allclose(along, difference, rtol=1e-5, atol=1e-9)


def test_a_run_is_near_what_can_be_had() -> None:
    """Measurements at will know the map better by little: descents begin at the run's places."""
    problem = load("fig3")
    problem = replace(problem, planner=replace(problem.planner, max_steps=20))
    found = known(problem, seed=0)
    assert found.driven_db <= 1.1 * found.at_will_db


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problem")
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--horizon", type=int)
    arguments = parser.parse_args()
    if arguments.seeds < FEWEST_GROUPS:
        parser.error(f"--seeds: an interval needs at least {FEWEST_GROUPS}")
    problem = load(arguments.problem)
    if arguments.horizon is not None:
        problem = replace(problem, planner=replace(problem.planner, horizon=arguments.horizon))
    rows: list[Known] = []
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
        rows.append(known(problem, seed))
        print(f"seed {seed}: driven {rows[-1].driven_db:.3f}, at will {rows[-1].at_will_db:.3f} dB")
    multipath = rows[0].multipath_std_db
    for name, values in (
        ("driven", [each.driven_db for each in rows]),
        ("at will", [each.at_will_db for each in rows]),
        ("driven, with multipath", [np.hypot(each.driven_db, multipath) for each in rows]),
        ("at will, with multipath", [np.hypot(each.at_will_db, multipath) for each in rows]),
    ):
        low, high = mean_interval(np.array(values))
        print(f"{name}: {np.mean(values):.3f} ({low:.3f} to {high:.3f}) dB")


if __name__ == "__main__":
    main()
