"""Joint estimation of the channel and the station's position."""

import dataclasses

import numpy as np
import pytest
from simulated_channel import simulated, subset

from planopt.channel.fit import fit_channel
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.path_loss import regressors
from planopt.channel.station_search import fit_channel_and_station
from planopt.errors import InputError

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


def test_exact_path_loss_gives_the_exact_place():
    """Without any fading the position comes out within the search's tolerance."""
    positions = np.random.default_rng(0).uniform(0.0, 200.0, (60, 2))
    power = regressors(positions, CHANNEL.station) @ [-40.0, 3.0]
    measurements = Measurements(positions, power, np.zeros(60, bool))
    fit = fit_channel_and_station(measurements, height_m=10.0)
    assert distance(fit, (130.0, 70.0)) < 0.5


def test_the_method_is_that_of_the_final_fit():
    """At the estimated station the result is the ordinary fit's, with the warning in front."""
    measurements = simulated(CHANNEL, 4, 80, 200.0)
    found = fit_channel_and_station(measurements, "capped", 10.0)
    plain = fit_channel(measurements, found.parameters.station, "capped")
    assert found.parameters == plain.parameters
    assert found.warnings[1:] == plain.warnings


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
