"""Enclosures of the predicted power contain it everywhere in their discs."""

import numpy as np
import pytest

from planopt.bounds.enclosure import PowerEnclosure
from planopt.channel import ChannelParameters, ChannelPosterior, Measurements, Station, condition

THRESHOLD_DBM = -70.0


def posterior_of(seed: int, count: int = 60, **changes: float) -> ChannelPosterior:
    """A channel measured at random positions, with a censored and a repeated one among them."""
    generator = np.random.default_rng(seed)
    settings = {
        "k_pl_db": -30.0,
        "n_pl": 2.6,
        "shadow_std_db": 6.0,
        "decorrelation_m": float(generator.uniform(3.0, 25.0)),
        "multipath_std_db": float(generator.uniform(0.8, 3.0)),
    }
    parameters = ChannelParameters(**{**settings, **changes}, station=Station((20.0, 15.0), 1.0))
    positions = generator.uniform(0.0, 60.0, (count, 2))
    positions[1] = positions[0]
    power = -30.0 - 26.0 * np.log10(np.hypot(*(positions - (20.0, 15.0)).T) + 1.0)
    power += generator.normal(0.0, 6.0, count)
    censored = np.zeros(count, dtype=bool)
    censored[2] = True
    return condition(parameters, Measurements(positions, power, censored=censored))


def discs(posterior: ChannelPosterior, radius_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Centres anywhere, beside measured positions and at the station; and their radii."""
    generator = np.random.default_rng(1)
    centres = np.vstack(
        [
            generator.uniform(-10.0, 70.0, (80, 2)),
            posterior.measurements.positions_m[:40] + generator.normal(0.0, 0.3, (40, 2)),
            [posterior.parameters.station.position_m],
        ]
    )
    return centres, np.full(len(centres), radius_m)


def turned(corners: np.ndarray, count: int) -> np.ndarray:
    """The corners of a polygon in the unit disc, turned by random angles; (count, k, 2)."""
    angle = np.random.default_rng(count).uniform(0.0, 2.0 * np.pi, count)
    turns = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    corners = corners / np.maximum(1.0, np.linalg.norm(corners, axis=1))[:, None]
    return np.einsum("kd,dcn->nkc", corners, turns)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("radius_m", [6.0, 1.0, 0.1])
def test_every_position_of_a_disc_is_enclosed(seed: int, radius_m: float) -> None:
    """Mean, variance and probability at random positions stay within their bounds."""
    posterior = posterior_of(seed)
    centre, radius = discs(posterior, radius_m)
    model = PowerEnclosure(posterior).over(centre, radius)
    corners = radius_m * turned(np.array([[0.0, 1.0], [-1.0, -0.3], [0.8, -0.6]]), len(centre))
    bound = model.probability_above(THRESHOLD_DBM, corners)
    generator = np.random.default_rng(seed)
    compared = 0
    for _ in range(50):
        angle = generator.uniform(0.0, 2.0 * np.pi, len(centre))
        share = np.sqrt(generator.uniform(0.0, 1.0, len(centre)))
        offset = (radius * share)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        found = posterior.predict(centre + offset)
        squares = np.array([offset[:, 0] ** 2, offset.prod(axis=1), offset[:, 1] ** 2])
        mean = model.mean_db + (model.mean_slope.T * offset).sum(axis=1)
        mean += (model.mean_form * squares).sum(axis=0)
        assert (found.mean_db >= mean + model.mean_low).all()
        assert (found.mean_db <= mean + model.mean_high).all()
        variance = model.variance_db2 + (model.variance_slope.T * offset).sum(axis=1)
        variance += (model.variance_form * squares).sum(axis=0)
        assert (found.deviation_db**2 >= variance + model.variance_low).all()
        assert (found.deviation_db**2 <= variance + model.variance_high).all()
        weight = generator.dirichlet((0.5, 0.5, 0.5), len(centre))
        chance = posterior.connectivity(
            centre + np.einsum("nk,nkd->nd", weight, corners), THRESHOLD_DBM
        )
        assert (chance <= (bound * weight).sum(axis=1) + 1e-12).all()
        compared += len(centre)
    assert compared == 50 * 121


def test_centres_are_predicted_exactly() -> None:
    """The value of a model at its centre is the posterior's own prediction."""
    posterior = posterior_of(3)
    centre, radius = discs(posterior, 1.0)
    model = PowerEnclosure(posterior).over(centre, radius)
    found = posterior.predict(centre)
    np.testing.assert_allclose(model.mean_db, found.mean_db, rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(model.variance_db2), found.deviation_db, rtol=1e-7)
    np.testing.assert_allclose(
        model.probability(THRESHOLD_DBM), posterior.connectivity(centre, THRESHOLD_DBM), atol=1e-9
    )


def test_bounds_tighten_with_the_square_of_the_radius() -> None:
    """Away from measurements half the radius leaves at most about a quarter of the looseness."""
    posterior = posterior_of(5, decorrelation_m=20.0)
    centre = np.random.default_rng(2).uniform(0.0, 60.0, (200, 2))
    away = np.linalg.norm(centre[:, None] - posterior.measurements.positions_m, axis=2).min(axis=1)
    centre = centre[away > 2.0]
    power = PowerEnclosure(posterior)
    chance = posterior.connectivity(centre, THRESHOLD_DBM)
    square = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    slack = [
        np.median(
            power.over(centre, np.full(len(centre), radius))
            .probability_above(THRESHOLD_DBM, radius * turned(square, len(centre)))
            .mean(axis=1)
            - chance
        )
        for radius in (0.4, 0.2, 0.1)
    ]
    assert 3.5 < slack[0] / slack[1] < 8.5
    assert 3.5 < slack[1] / slack[2] < 8.5
