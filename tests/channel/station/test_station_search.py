"""Joint estimation of the channel and the station's position."""

import dataclasses

import numpy as np
import pytest
from simulated_channel import simulated, subset

from planopt import InputError
from planopt.channel import (
    ChannelParameters,
    Measurements,
    Station,
    fit_channel,
    fit_channel_and_station,
)

CHANNEL = ChannelParameters(-40.0, 3.0, 3.0, 20.0, 1.0, Station((130.0, 70.0), 10.0))


def distance(fit, station):
    """From the estimated station to the true one."""
    return np.hypot(*np.subtract(fit.parameters.station.position_m, station))


@pytest.mark.parametrize(("place", "error_m"), [((130.0, 70.0), 10.0), ((-60.0, 250.0), 80.0)])
def test_finds_a_station_inside_and_outside(place, error_m):
    """With censoring, a station is found well within the measured square, less well beyond it."""
    channel = dataclasses.replace(CHANNEL, station=Station(place, 10.0))
    measurements = simulated(channel, 3, 150, 200.0, 0.15)
    fit = fit_channel_and_station(measurements, height_m=10.0)
    assert distance(fit, place) < error_m
    assert fit.parameters.n_pl == pytest.approx(3.0, abs=0.8)
    assert "is estimated, not given" in fit.warnings[0]


def test_the_method_is_that_of_the_final_fit():
    """At the estimated station the result is the ordinary fit's, with the warning in front."""
    measurements = simulated(CHANNEL, 4, 80, 200.0)
    found = fit_channel_and_station(measurements, "capped", 10.0)
    plain = fit_channel(measurements, found.parameters.station, "capped")
    assert found.parameters == plain.parameters
    assert found.warnings[1:] == plain.warnings
    assert plain.station_covariance_m2 is None


def steadily_rising():
    """Powers that rise to one side alone: the line's station goes as far as it may."""
    positions = np.random.default_rng(3).uniform(0.0, 100.0, (60, 2))
    noise = np.random.default_rng(4).normal(0.0, 2.0, 60)
    return Measurements(positions, -80.0 + 0.05 * positions[:, 0] + noise, np.zeros(60, bool))


def mostly_shadowing():
    """Powers that slow shadowing explains as well as any station does."""
    weak = dataclasses.replace(CHANNEL, n_pl=0.3, shadow_std_db=8.0, decorrelation_m=80.0)
    return simulated(weak, 7, 40, 200.0)


CASES = {"line": steadily_rising, "joint": mostly_shadowing}


@pytest.mark.parametrize("station_method", CASES)
def test_what_is_not_bounded_is_infinite_and_said(station_method):
    """No number stands for a position that may be anywhere."""
    found = fit_channel_and_station(CASES[station_method](), station_method=station_method)
    assert found.status == "degenerate"
    assert "is not bounded" in found.warnings[0]
    np.testing.assert_array_equal(found.station_covariance_m2, np.diag([np.inf, np.inf]))
    assert found.standard_errors["n_pl"] == np.inf
    assert np.isfinite(found.theta_covariance).all()


def test_random_small_cases_are_fits_or_input_errors():
    """Few, clustered, nearly collinear, repeated, censored, at either way of the position."""
    rng = np.random.default_rng(0)
    fitted = 0
    for case in range(40):
        count = int(rng.integers(2, 16))
        positions = rng.uniform(0.0, 100.0, (count, 2))
        positions[:, 1] *= rng.choice([1.0, 1e-2, 0.0])
        positions = positions[rng.integers(0, count, count)] if case % 3 == 0 else positions
        power = rng.normal(-70.0, 5.0, count)
        measurements = Measurements(positions, power, rng.random(count) < 0.15)
        method = "line" if case % 2 else "joint"
        try:
            found = fit_channel_and_station(measurements, station_method=method)
        except InputError:
            continue
        fitted += 1
        assert np.isfinite(found.parameters.station.position_m).all()
        assert not np.isnan(found.station_covariance_m2).any()
    assert fitted > 5


def test_a_way_that_does_not_exist():
    """Is an error that names those that do."""
    with pytest.raises(InputError, match="line, joint"):
        fit_channel_and_station(simulated(CHANNEL, 4, 20, 200.0), station_method="guess")


def test_a_station_on_a_measurement_is_moved_off_it():
    """When the best position is that of a measurement, log of zero is avoided."""
    axis = np.arange(-4.0, 5.0)
    lattice = 10.0 * np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    power = -40.0 - 30.0 * np.log10(np.maximum(np.hypot(*lattice.T), 0.1))
    measurements = Measurements(lattice, power, np.zeros(81, bool))
    assert distance(fit_channel_and_station(measurements), (0.0, 0.0)) < 0.5


def test_what_cannot_locate_is_refused():
    """Too few, on one line, all in one place, or growing away from everywhere."""
    measurements = simulated(CHANNEL, 5, 40, 200.0)
    with pytest.raises(InputError, match="7 uncensored measurements"):
        fit_channel_and_station(subset(measurements, slice(7)))
    line = np.outer(np.arange(40.0), [1.0, 2.0])
    with pytest.raises(InputError, match="on one line"):
        fit_channel_and_station(dataclasses.replace(measurements, positions_m=line))
    with pytest.raises(InputError, match="in one place"):
        fit_channel_and_station(dataclasses.replace(measurements, positions_m=np.ones((40, 2))))
    flat = dataclasses.replace(measurements, power_dbm=np.full(40, -70.0))
    with pytest.raises(InputError, match="from every position"):
        fit_channel_and_station(flat)
