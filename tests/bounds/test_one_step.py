"""One-step problems (2), (3) and (4) of [GM11] against grids of values computed from scratch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import shapely
from scipy.special import ndtr

from planopt.bounds.one_step import BestPlace, best_place
from planopt.bounds.stages import quantity_makers
from planopt.bounds.tube import StageProblem
from planopt.channel import ChannelParameters, Measurements, Station, condition
from planopt.objectives.upper_bounds import (
    Discs,
    Field,
    UpperBounds,
    closeness_bounds,
    constant_bounds,
    sensing_bounds,
)
from planopt.targets.information_filter import Sensor

SIDE_M = 20.0
BLOCK = shapely.box(11.0, 8.0, 14.0, 13.0)
STATION_M = (1.0013, 2.0017)
THRESHOLD_DBM, DECAY_PER_M, KNOWN_DB2 = -38.0, 0.2, 2.0
SENSOR, TARGET_M = Sensor(0.02, 0.2, 1.0), np.array([13.0, 6.0])


@dataclass(frozen=True)
class Scene:
    """A channel with known path loss, its measurements, and a robot."""

    parameters: ChannelParameters
    places_m: np.ndarray
    power_dbm: np.ndarray
    here_m: np.ndarray

    @classmethod
    def of(cls, seed: int) -> Scene:
        """A random scene."""
        generator = np.random.default_rng(seed)
        shadow, beta, fading = generator.uniform([2.0, 1.0, 1.0], [5.0, 10.0, 3.0])
        parameters = ChannelParameters(-10.0, 2.0, shadow, beta, fading, Station(STATION_M))
        places = generator.uniform(0.0, SIDE_M, (15, 2))
        power = -10.0 - 20.0 * np.log10(np.hypot(*(places - STATION_M).T))
        power += generator.normal(0.0, 3.0, len(places))
        return cls(parameters, places, power, np.array([10.0, 10.0]) - generator.uniform(size=2))

    def problem(self, reward: Callable[[int, Field], UpperBounds], step_m: float) -> StageProblem:
        """The stage problem of a reward."""
        data = Measurements(self.places_m, self.power_dbm)
        posterior = condition(self.parameters, data, theta="known")
        return StageProblem(
            start_m=self.here_m,
            step_m=step_m,
            steps=1,
            limits_m=np.array([[0.0, 0.0, SIDE_M, SIDE_M]]),
            blocked=[BLOCK],
            makers=quantity_makers([posterior], [THRESHOLD_DBM], posterior),
            reward=reward,
            sure_m=np.zeros((0, 2)),
            sure_radius_m=0.0,
        )

    def moments(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean, variance and regressors phi (n, 2) at positions, from Lemmas 1 and 2 of [GM11]."""
        own = self.parameters
        away = np.linalg.norm(self.places_m[:, None] - self.places_m, axis=2)
        whole = own.shadow_std_db**2 * np.exp(-away / own.decorrelation_m)
        whole += own.multipath_std_db**2 * np.eye(len(away))
        across = np.linalg.norm(places[:, None] - self.places_m, axis=2)
        phi = own.shadow_std_db**2 * np.exp(-across / own.decorrelation_m)
        gain = np.linalg.solve(whole, phi.T).T
        known, wanted = (
            np.column_stack([np.ones(len(at)), -10.0 * np.log10(np.hypot(*(at - STATION_M).T))])
            for at in (self.places_m, places)
        )
        theta = np.array([own.k_pl_db, own.n_pl])
        mean = wanted @ theta + gain @ (self.power_dbm - known @ theta)
        variance = own.shadow_std_db**2 + own.multipath_std_db**2 - (gain * phi).sum(axis=1)
        return mean, variance, wanted - gain @ known


def learning(stage: int, field: Field) -> UpperBounds:
    """The bounds of (2)."""
    return field["trend"].positive_part()


def tracking(stage: int, field: Field) -> UpperBounds:
    """The bounds of (4)."""
    return field["chance"].times(sensing_bounds(SENSOR, TARGET_M, field.discs))


def solutions(scene: Scene, kind: str) -> tuple[BestPlace, np.ndarray, float]:
    """The solution of a problem, the values of its objective on a grid, and that of its place."""

    def mapping(stage: int, field: Field) -> UpperBounds:
        near = closeness_bounds(DECAY_PER_M, scene.here_m, field.discs)
        least = constant_bounds(field.discs, -KNOWN_DB2)
        return field["variance_db2"].plus(least).positive_part().times(near)

    reward, step = {"2": (learning, 1.75), "3": (mapping, 40.0), "4": (tracking, 2.0)}[kind]
    best = best_place(scene.problem(reward, step), 10.0)
    line = np.linspace(0.0, SIDE_M, 101 if kind == "3" else 401)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    grid = grid[np.hypot(*(grid - scene.here_m).T) <= step]
    grid = np.vstack([grid[~shapely.contains_xy(BLOCK, *grid.T)], best.place_m])
    mean, variance, phi = scene.moments(grid)
    away = np.hypot(*(grid - scene.here_m).T)
    if kind == "2":
        values = (phi**2).sum(axis=1) / variance
    elif kind == "3":
        values = np.maximum(variance - KNOWN_DB2, 0.0) * np.exp(-DECAY_PER_M * away)
    else:
        noise = 0.02 * (np.hypot(*(grid - TARGET_M).T) - 1.0) ** 2 + 0.2
        values = ndtr((mean - THRESHOLD_DBM) / np.sqrt(variance)) / noise
    return best, values[:-1], float(values[-1])


@pytest.mark.parametrize("kind", ["2", "3", "4"])
def test_no_position_of_a_grid_is_better(kind: str) -> None:
    """The position's own value is the best of a fine grid, and is proven to a millionth."""
    compared = 0
    for seed in range(6):
        best, values, own = solutions(Scene.of(seed), kind)
        assert own == pytest.approx(best.value, rel=1e-7, abs=2e-8)
        assert values.max() <= min(best.bound, best.value + 1e-6 * max(1.0, best.value))
        assert best.value <= best.bound and best.gap <= 2e-6
        assert not shapely.contains_xy(BLOCK, *best.place_m)
        compared += len(values)
    print(f"{compared} comparisons")
    assert compared > 10_000


def test_bounds_of_predictions_hold_inside_their_discs() -> None:
    """Variance, trace and their products are at most their bounds at random positions."""
    generator = np.random.default_rng(0)
    compared = 0
    for seed in range(6):
        scene = Scene.of(seed)
        makers = scene.problem(learning, 1.0).makers
        for radius in (1e-3, 0.1, 1.0):
            centre = generator.uniform(2.0, SIDE_M, (20, 2))
            discs = Discs(centre, radius)
            angle, share = generator.uniform(0.0, 2.0 * np.pi, 50), generator.uniform(size=50)
            circle = np.column_stack([np.cos(angle), np.sin(angle)])
            offset = radius * np.sqrt(share)[:, None] * circle
            places = (centre[:, None] + offset).reshape(-1, 2)
            _, variance, phi = scene.moments(places)
            near = np.exp(-0.3 * np.hypot(*(places - scene.here_m).T))
            for bounds, truth in (
                (makers["variance_db2"](discs), variance),
                (makers["trend"](discs), (phi**2).sum(axis=1) / variance),
                (closeness_bounds(0.3, scene.here_m, discs), near),
            ):
                values = truth.reshape(20, 50)
                slack = 1e-9 * np.abs(values).max()
                linear = bounds.value[:, None] + bounds.slope @ offset.T
                assert (values <= linear + slack).all()
                assert (values <= bounds.most[:, None] + slack).all()
                compared += 2 * values.size
    print(f"{compared} comparisons")
    assert compared == 6 * 3 * 3 * 2000
