"""Age, receivers' offsets and position errors in every predictor, against dense algebra."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from varied_measurements import (
    DRIFTING,
    STEADY,
    at_places,
    dense_covariance,
    dense_prediction,
    varied,
)

from planopt.channel import at_time, condition, conditional_field, joint_prediction
from planopt.channel.channel_map import TileMap
from planopt.channel.kriging import LocalChannel, predict, predict_nearby
from planopt.channel.measurements import (
    covariance_db2,
    measured_origins,
    own_covariance_db2,
    own_variance_db2,
    place_origins,
)
from planopt.objectives.stage_power import StagePredictor

PLACES = np.random.default_rng(3).uniform(0.0, 50.0, (40, 2))
LATER_S = 900.0


@pytest.mark.parametrize("parameters", [DRIFTING, STEADY])
@pytest.mark.parametrize("errors", [True, False])
@pytest.mark.parametrize("receivers", [1, 3])
def test_the_covariance_is_its_definition(parameters, errors, receivers):
    """Among measurements, between sets, and to places, in batches too."""
    first = varied(20, 1, errors=errors, receivers=receivers)
    second = varied(15, 2, errors=errors, receivers=receivers)
    one, other = (measured_origins(part, parameters) for part in (first, second))
    own = own_covariance_db2(one, parameters)
    np.testing.assert_allclose(own, dense_covariance(parameters, first), rtol=1e-12)
    np.testing.assert_allclose(np.diag(own), own_variance_db2(one, parameters))
    np.testing.assert_allclose(
        covariance_db2(one, other, parameters),
        dense_covariance(parameters, first, second),
        rtol=1e-12,
    )
    places = place_origins(PLACES, 700.0, parameters, np.full(len(PLACES), 1.5))
    np.testing.assert_allclose(
        covariance_db2(one, places, parameters),
        dense_covariance(parameters, first, at_places(PLACES, 700.0, 1.5)),
        rtol=1e-12,
    )
    rows = np.array([[3, 7, 1], [0, 19, 4]])
    batched = own_covariance_db2(one.at(rows), parameters)
    for part, chosen in zip(batched, rows, strict=True):
        np.testing.assert_allclose(part, own[np.ix_(chosen, chosen)], rtol=1e-12)


def test_it_is_a_covariance():
    """No direction has negative variance, repeated places and large errors included."""
    data = varied(60, 4)
    twice = data.take(np.concatenate([np.arange(60), np.arange(60)]))
    wide = replace(twice, position_std_m=5.0 * twice.position_std_m)
    values = np.linalg.eigvalsh(own_covariance_db2(measured_origins(wide, DRIFTING), DRIFTING))
    assert values[0] > -1e-9


@pytest.mark.parametrize("parameters", [DRIFTING, STEADY])
@pytest.mark.parametrize("censored", [0.0, 0.2])
def test_the_posterior_is_dense_kriging(parameters, censored):
    """Now and later, where the robot is sure of its place and where not."""
    posterior = condition(parameters, varied(60, 5, censored=censored))
    assert posterior.now_s == posterior.measurements.time_s.max()
    for now_s in (posterior.now_s, LATER_S):
        found = at_time(posterior, now_s).predict(PLACES)
        mean, deviation = dense_prediction(posterior, PLACES, now_s)
        np.testing.assert_allclose(found.mean_db, mean, atol=1e-8)
        np.testing.assert_allclose(found.deviation_db, deviation, atol=1e-8)
    blurred = predict(posterior, PLACES, np.full(len(PLACES), 2.0))
    mean, deviation = dense_prediction(posterior, PLACES, posterior.now_s, 2.0)
    np.testing.assert_allclose(blurred.mean_db, mean, atol=1e-8)
    assert (blurred.deviation_db > deviation).all()
    assert blurred.deviation_db.mean() > posterior.predict(PLACES).deviation_db.mean()


def test_one_by_one_equals_batch():
    """Extending keeps the factor, moves the time on, and knows receivers that were not there."""
    data = varied(50, 6)
    data = replace(data, receiver=np.where(np.arange(50) < 20, 0, data.receiver))
    grown = condition(DRIFTING, data.take(slice(20)))
    assert grown.now_s == data.time_s[19]
    for row in range(20, 50):
        grown = grown.extend(data.take(slice(row, row + 1)))
    whole = condition(DRIFTING, data)
    assert grown.now_s == whole.now_s
    found, expected = grown.predict(PLACES), whole.predict(PLACES)
    np.testing.assert_allclose(found.mean_db, expected.mean_db, atol=1e-9)
    np.testing.assert_allclose(found.deviation_db, expected.deviation_db, atol=1e-9)


def test_a_late_limit_is_one_of_its_receiver():
    """A limit of a receiver that reads 20 dB more says that the power is low, of another little."""
    data = varied(60, 7, errors=False, receivers=2)
    data = replace(data, power_dbm=data.power_dbm + 20.0 * data.receiver)
    posterior = condition(STEADY, data)
    at = np.array([[25.0, 25.0]])
    limit = at_places(at, posterior.now_s)
    limit = replace(limit, power_dbm=posterior.predict(at).mean_db, censored=np.array([True]))
    by_reference = posterior.extend(limit)
    by_other = posterior.extend(replace(limit, receiver=np.array([1])))
    before = posterior.predict(at).mean_db[0]
    # The other receiver would have read some 26 dB more: at most the mean is far below.
    assert by_other.predict(at).mean_db[0] < by_reference.predict(at).mean_db[0] - 1.0
    assert by_reference.predict(at).mean_db[0] < before


@pytest.mark.parametrize("parameters", [DRIFTING, STEADY])
def test_all_predictors_agree(parameters):
    """Many places at once, joint, and local with all measurements."""
    posterior = at_time(condition(parameters, varied(70, 9, censored=0.1)), 650.0)
    expected = posterior.predict(PLACES)
    many = posterior.predict(np.tile(PLACES, (30, 1)))
    joint = joint_prediction(posterior, PLACES)
    local = LocalChannel.around(posterior, PLACES, 80).predict(PLACES)
    nearby = predict_nearby(posterior, PLACES, 70)
    for mean, deviation in (
        (many.mean_db[:40], many.deviation_db[:40]),
        (joint.mean_db, joint.deviation_db),
        (local.mean_db, local.deviation_db),
        (nearby.mean_db, nearby.deviation_db),
    ):
        np.testing.assert_allclose(mean, expected.mean_db, atol=1e-7)
        np.testing.assert_allclose(deviation, expected.deviation_db, atol=1e-7)


def test_offsets_come_from_all_measurements():
    """Beside measurements of another receiver alone the local prediction keeps its level."""
    data = varied(400, 10, errors=False, receivers=2)
    left = data.positions_m[:, 0] < 25.0
    data = replace(data, receiver=left.astype(np.intp))
    posterior = condition(STEADY, data)
    places = PLACES[PLACES[:, 0] < 18.0]
    exact = posterior.predict(places)
    local = LocalChannel.around_each(posterior, places, 30).predict(places[:, None])
    nearby = predict_nearby(posterior, places, 30)
    for found in (local, nearby):
        assert np.abs(found.mean_db.ravel() - exact.mean_db).max() < 0.3
        assert np.abs(found.deviation_db.ravel() - exact.deviation_db).max() < 0.1


@pytest.mark.parametrize("receivers", [1, 3])
@pytest.mark.parametrize("neighbours", [12, 100])
def test_the_tile_map_ages(receivers, neighbours):
    """An aged, extended map is the one built from nothing: parts fade, newcomers replace."""
    data = varied(80, 12, receivers=receivers)
    x = np.arange(1.0, 50.0, 4.0)
    needed = np.ones((len(x), len(x)), dtype=bool)
    kept = TileMap(x, x, needed, tile=3, neighbours=neighbours)
    posterior = condition(DRIFTING, data.take(slice(40)))
    kept.refresh(posterior)
    for row in range(40, 80, 2):
        posterior = posterior.extend(data.take(slice(row, row + 2)))
        kept.refresh(at_time(posterior, posterior.now_s + 3.0))
    for moment in (posterior.now_s + 10.0, 50.0, posterior.now_s + 20.0):
        kept.refresh(at_time(posterior, moment))
        fresh = TileMap(x, x, needed, tile=3, neighbours=neighbours)
        fresh.refresh(at_time(posterior, moment))
        np.testing.assert_allclose(kept.mean_db, fresh.mean_db, atol=1e-7)
        np.testing.assert_allclose(kept.deviation_db, fresh.deviation_db, atol=1e-7)


def test_derivatives_are_slopes():
    """Of the aged mean and deviation; also at a place measured with an error of position."""
    posterior = at_time(condition(DRIFTING, varied(30, 13)), 640.0)
    uncertain = posterior.measurements.positions_m[1:2] + 1e-3
    places = np.concatenate([PLACES[:5], uncertain])
    predictor = StagePredictor(LocalChannel.around_each(posterior, places, 30))
    found = predictor(places)
    for axis, bends in ((0, [0, 1]), (1, [1, 2])):
        step = 1e-4 * np.eye(2)[axis]
        for own, more, less in zip(
            found, predictor(places + step), predictor(places - step), strict=True
        ):
            slope = (more.value - less.value) / 2e-4
            np.testing.assert_allclose(own.gradient[:, axis], slope, atol=1e-6)
            bend = (more.gradient - less.gradient) / 2e-4
            np.testing.assert_allclose(own.hessian[:, bends], bend, atol=1e-5)


def test_fields_are_drawn_with_offsets() -> None:
    """Draws agree with the posterior, also with errors of position; of ages there is an error."""
    data = varied(30, 14)
    posterior = condition(STEADY, data)
    generator = np.random.default_rng(0)
    bounds = (20.0, 20.0, 60.0, 50.0)
    fields = [conditional_field(posterior, bounds, 10.0, generator) for _ in range(600)]
    draws = np.array([field.values.ravel() for field in fields])
    centres = np.stack(np.meshgrid(fields[0].x_m, fields[0].y_m), axis=-1).reshape(-1, 2)
    expected = posterior.predict(centres)
    latent = np.sqrt(expected.deviation_db**2 - 1.5**2)
    error = latent / np.sqrt(600.0)
    assert (np.abs(draws.mean(axis=0) - expected.mean_db) < 4.0 * error).all()
    np.testing.assert_allclose(draws.std(axis=0), latent, rtol=0.08)
    with refused():
        conditional_field(condition(DRIFTING, data), (0.0, 0.0, 10.0, 10.0), 1.0, generator)
