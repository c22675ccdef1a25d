"""Mapping: equation (3), batch = sequential = re-conditioning, monotonicity, simulated errors."""

import dataclasses

import numpy as np
import pytest
from path_scene import CHANNEL, NOTHING, PATH, START, drawn, measured_at, moved, power_at

from planopt.channel.kriging import predict
from planopt.channel.measurement_covariance import shadow_covariance_db2
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import Station
from planopt.channel.posterior import condition, extend
from planopt.errors import InputError
from planopt.objectives.mapping import (
    Region,
    Uncertainty,
    average_reduction,
    channel_uncertainty,
    path_information,
    path_uncertainty,
    uncertainty_target,
)

DATA = drawn(15)
POSTERIOR = condition(CHANNEL, DATA)
KNOWN = condition(CHANNEL, DATA, theta="known")
SETTINGS = Uncertainty(8.0, 0.02, START)
GRID = np.random.default_rng(4).uniform(0.0, 60.0, (30, 2))
REGION = Region(GRID, np.linspace(0.5, 1.5, 30) / 30.0)


def lemma_2_variance(places):
    """sigma^2(q) = xi^2 + omega^2 - phi' U^-1 phi (equation 1.6), by dense inverses."""
    u = shadow_covariance_db2(DATA.positions_m, DATA.positions_m, CHANNEL) + 4.0 * np.eye(15)
    phi = shadow_covariance_db2(DATA.positions_m, places, CHANNEL)
    return 25.0 + 4.0 - (phi * np.linalg.solve(u, phi)).sum(axis=0)


def step_variances(posterior):
    """Variance at each place of the path once the earlier ones are measured."""
    found = []
    for place in PATH:
        found.append(predict(posterior, place[None]).deviation_db[0] ** 2)
        posterior = extend(posterior, measured_at(place[None]))
    return np.array(found)


@pytest.mark.parametrize("posterior", [POSTERIOR, KNOWN], ids=["estimated", "known"])
def test_one_step_is_the_seeds_j_ch(posterior):
    """The variance above the threshold, discounted by distance; the path form at h = 1."""
    settings = dataclasses.replace(SETTINGS, universal=False)
    distance = np.linalg.norm(PATH - START, axis=1)
    variance = lemma_2_variance(PATH)
    expected = np.maximum(0.0, variance - 8.0) * np.exp(-0.02 * distance)
    assert (expected > 0.0).any()
    found = channel_uncertainty(posterior, PATH, distance, settings)
    np.testing.assert_allclose(found, expected, rtol=1e-10)
    for place, one in zip(PATH, expected, strict=True):
        value = path_uncertainty(posterior, place[None], settings)
        assert value == pytest.approx(one, rel=1e-10, abs=1e-12)


def test_the_target_is_the_argument_of_the_maximum():
    """Brute force over the grid; distance decides when it is made to."""
    distance = np.linalg.norm(GRID - START, axis=1)
    worth = channel_uncertainty(POSTERIOR, GRID, distance, SETTINGS)
    assert uncertainty_target(POSTERIOR, GRID, distance, SETTINGS) == int(np.argmax(worth))
    near = Uncertainty(0.0, 50.0, START)
    assert uncertainty_target(POSTERIOR, GRID, distance, near) == int(np.argmin(distance))
    free = Uncertainty(0.0, 0.0, START)
    variance = predict(POSTERIOR, GRID).deviation_db
    assert uncertainty_target(POSTERIOR, GRID, distance, free) == int(np.argmax(variance))


def test_a_map_that_is_good_enough_has_no_target():
    """Nothing above the threshold: None, not the first place."""
    settings = Uncertainty(1e4, 0.02, START)
    assert uncertainty_target(POSTERIOR, GRID, np.ones(30), settings) is None


@pytest.mark.parametrize("posterior", [POSTERIOR, KNOWN], ids=["estimated", "known"])
def test_path_form_is_the_sum_over_steps(posterior):
    """Variances by conditioning place after place, lengths by adding legs; 1e-10."""
    lengths = np.cumsum(np.linalg.norm(np.diff(np.vstack([START, PATH]), axis=0), axis=1))
    variance = step_variances(posterior)
    expected = (np.maximum(0.0, variance - 8.0) * np.exp(-0.02 * lengths)).sum()
    assert path_uncertainty(posterior, PATH, SETTINGS) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("posterior", [POSTERIOR, KNOWN], ids=["estimated", "known"])
def test_information_is_the_sum_over_steps(posterior):
    """1/2 sum log(sigma_{t+i-1}^2 / omega^2); with one step monotone in the variance."""
    expected = 0.5 * np.log(step_variances(posterior) / 4.0).sum()
    assert path_information(posterior, PATH) == pytest.approx(expected, rel=1e-10)
    each = [path_information(posterior, place[None]) for place in GRID]
    variance = predict(posterior, GRID).deviation_db
    np.testing.assert_array_equal(np.argsort(each), np.argsort(variance))


@pytest.mark.parametrize("posterior", [POSTERIOR, KNOWN], ids=["estimated", "known"])
def test_average_reduction_is_that_of_the_extended_posterior(posterior):
    """sum_g w_g (sigma_t^2 - sigma_{t+h}^2) by measuring the path and predicting again."""
    after = extend(posterior, measured_at(PATH))
    less = predict(posterior, GRID).deviation_db ** 2 - predict(after, GRID).deviation_db ** 2
    assert (less >= -1e-10).all()
    found = average_reduction(posterior, PATH, REGION)
    assert found == pytest.approx(float(REGION.weight @ less), rel=1e-9)


def test_as_if_theta_were_known():
    """Without `universal` the numbers are those of the posterior that knows theta."""
    plain = dataclasses.replace(SETTINGS, universal=False)
    region = dataclasses.replace(REGION, universal=False)
    for found, expected in (
        (path_uncertainty(POSTERIOR, PATH, plain), path_uncertainty(KNOWN, PATH, SETTINGS)),
        (path_information(POSTERIOR, PATH, False), path_information(KNOWN, PATH)),
        (average_reduction(POSTERIOR, PATH, region), average_reduction(KNOWN, PATH, REGION)),
    ):
        assert found == pytest.approx(expected, rel=1e-10)
    assert path_information(POSTERIOR, PATH) > path_information(POSTERIOR, PATH, False)


def test_more_places_never_tell_less():
    """Along every path, and submodular: a place tells less after more places."""
    for value in (
        lambda path: path_information(POSTERIOR, path),
        lambda path: average_reduction(POSTERIOR, path, REGION),
        lambda path: path_uncertainty(POSTERIOR, path, SETTINGS),
    ):
        assert (np.diff([value(PATH[:k]) for k in range(1, 6)]) >= -1e-12).all()
    last = PATH[4:]
    gains = [
        path_information(POSTERIOR, np.vstack([PATH[:k], last]))
        - path_information(POSTERIOR, PATH[:k])
        for k in range(1, 5)
    ]
    assert (np.diff(gains) <= 1e-12).all()


def test_the_claimed_variance_is_the_simulated_error():
    """Universal kriging after the path: squared errors of 4,000 channels within 5 errors."""
    data, goal = DATA.positions_m[:8], np.array([[20.0, 16.0]])
    few = condition(CHANNEL, DATA.take(slice(8)))
    before = predict(few, goal).deviation_db[0] ** 2
    claimed = before - average_reduction(few, PATH, Region(goal, np.ones(1)))
    places = np.vstack([data, PATH, goal])

    def predicted(power):
        seen = Measurements(places[:-1], power, np.zeros(13, dtype=bool))
        return predict(condition(CHANNEL, seen), goal).mean_db[0]

    # The prediction is linear in the measurements, so that thirteen of them give it.
    weights = np.array([predicted(unit) for unit in np.eye(13)]) - predicted(np.zeros(13))
    power = power_at(places, CHANNEL, np.random.default_rng(0), 4000)
    errors = power[:, -1] - power[:, :-1] @ weights - predicted(np.zeros(13))
    assert abs((errors**2).mean() - claimed) < 5.0 * claimed * np.sqrt(2.0 / 4000)
    assert claimed < 0.7 * before


@pytest.mark.parametrize("scale", [1.0, 1000.0])
@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_moving_the_scene_and_another_unit_change_nothing(mirror, scale):
    """Turned, mirrored, shifted and in another unit of length, with zeta per that unit."""
    turn, shift = np.array([[0.6, -0.8 * mirror], [0.8, 0.6 * mirror]]), 7.0
    x, y = scale * turn @ np.array(CHANNEL.station.position_m) + shift
    other = dataclasses.replace(
        CHANNEL,
        decorrelation_m=scale * CHANNEL.decorrelation_m,
        station=Station((x, y), scale * CHANNEL.station.height_m),
    )
    posterior = condition(other, moved(DATA, turn, shift, scale))
    path, grid = (scale * places @ turn.T + shift for places in (PATH, GRID))
    a, b = scale * turn @ np.array(START) + shift
    for found, expected in (
        (
            path_uncertainty(posterior, path, Uncertainty(8.0, 0.02 / scale, (a, b))),
            path_uncertainty(POSTERIOR, PATH, SETTINGS),
        ),
        (path_information(posterior, path), path_information(POSTERIOR, PATH)),
        (
            average_reduction(posterior, path, Region(grid, REGION.weight)),
            average_reduction(POSTERIOR, PATH, REGION),
        ),
    ):
        assert found == pytest.approx(expected, rel=1e-8)


def test_the_order_of_measurements_does_not_matter():
    """A permutation of them, and for the last two forms of the path."""
    shuffled = condition(CHANNEL, DATA.take(np.random.default_rng(0).permutation(15)))
    assert path_uncertainty(shuffled, PATH, SETTINGS) == pytest.approx(
        path_uncertainty(POSTERIOR, PATH, SETTINGS), rel=1e-9
    )
    assert path_information(shuffled, PATH[::-1]) == pytest.approx(
        path_information(POSTERIOR, PATH), rel=1e-9
    )
    assert average_reduction(shuffled, PATH[::-1], REGION) == pytest.approx(
        average_reduction(POSTERIOR, PATH, REGION), rel=1e-9
    )


def test_without_multipath():
    """Information is refused with a reason; the path form takes a place twice, worth nothing."""
    dry = dataclasses.replace(CHANNEL, multipath_std_db=0.0)
    posterior = condition(dry, NOTHING, theta="known")
    with pytest.raises(InputError, match="infinite"):
        path_information(posterior, PATH)
    settings = Uncertainty(0.0, 0.0, START)
    twice = np.vstack([PATH[:1], PATH[:1]])
    assert path_uncertainty(posterior, twice, settings) == pytest.approx(25.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Region(GRID, np.ones(3)),
        lambda: Region(GRID[:, :1], np.ones(30)),
        lambda: Region(GRID, np.full(30, np.nan)),
        lambda: path_information(POSTERIOR, PATH * np.nan),
        lambda: path_uncertainty(POSTERIOR, PATH[:, :1], SETTINGS),
        lambda: channel_uncertainty(POSTERIOR, PATH[0], np.ones(2), SETTINGS),
    ],
)
def test_bad_input_is_ours(make):
    """Every check raises InputError."""
    with pytest.raises(InputError):
        make()
