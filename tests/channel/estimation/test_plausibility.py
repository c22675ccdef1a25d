"""Values that no channel has, and floors that were taken for powers."""

import numpy as np
import pytest
from simulated_channel import simulated

from planopt.channel import ChannelParameters, Measurements, Station, fit_channel
from planopt.channel.estimation.fit import implausible_values, suspected_floor

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((50.0, 50.0), 10.0))


def powers(values):
    places = np.random.default_rng(0).uniform(0.0, 9.0, (len(values), 2))
    return Measurements(places, np.asarray(values, float), np.zeros(len(values), bool))


@pytest.mark.parametrize(
    ("n_pl", "beta", "words"),
    [
        (0.66, 30.0, "n_PL of 0.66"),
        (6.4, 30.0, "n_PL of 6.40"),
        (-1.0, 30.0, "negative"),
        (3.0, 70.0, "70 m"),
    ],
)
def test_implausible_parameters(n_pl, beta, words):
    """One line for each, that says the value."""
    parameters = ChannelParameters(-40.0, n_pl, 6.0, beta, 2.0, CHANNEL.station)
    (said,) = implausible_values(parameters, powers([-70.0, -80.0]), 200.0)
    assert words in said


@pytest.mark.parametrize(("low", "high", "lines"), [(-90.0, 970.0, 1), (-900.0, 970.0, 2)])
def test_implausible_powers(low, high, lines):
    """Powers that no radio sends or receives; the fit of them is not `ok`."""
    said = implausible_values(CHANNEL, powers([low, -70.0, high]), 200.0)
    assert len(said) == lines and "970 dBm" in said[-1]
    scaled = simulated(CHANNEL, 0, 100, 300.0)
    told = Measurements(
        scaled.positions_m, np.interp(scaled.power_dbm, (-120, -60), (low, high)), scaled.censored
    )
    assert fit_channel(told, CHANNEL.station).status != "ok"


@pytest.mark.parametrize("step_db", [0.0, 0.01, 1.0])
def test_pile_at_the_lowest_power_is_reported(step_db):
    """A fit of 300 powers of which a sixth is at the floor names it, its count and the option."""
    exact = simulated(CHANNEL, 1, 300, 300.0)
    power = np.round(exact.power_dbm / step_db) * step_db if step_db else exact.power_dbm
    floor = np.sort(power)[50]
    told = Measurements(exact.positions_m, np.maximum(power, floor), exact.censored)
    count = int((told.power_dbm == floor).sum())
    fit = fit_channel(told, CHANNEL.station)
    assert fit.status != "ok"
    (said,) = [text for text in fit.warnings if "floor" in text]
    assert f"{count} of 300 powers equal the lowest" in said and f"--floor={floor:g}" in said
    marked = Measurements(told.positions_m, told.power_dbm, told.power_dbm == floor)
    assert suspected_floor(marked) is None


@pytest.mark.parametrize("step_db", [0.01, 0.1, 1.0, 3.0, 6.0, 10.0])
@pytest.mark.parametrize("count", [30, 300, 3000])
def test_rounding_is_no_floor(step_db, count):
    """Normal powers in steps: the lowest value never looks like a pile, in 40 draws."""
    generator = np.random.default_rng(2)
    for _ in range(40):
        values = np.round(generator.normal(-80.0, 8.0, count) / step_db) * step_db
        assert suspected_floor(powers(values)) is None


def test_few_or_equal():
    """Four equal powers are no pile, nor are all equal ones; the usual channel is plausible."""
    assert suspected_floor(powers([-90.0] * 4 + [-80.0, -70.0])) is None
    assert suspected_floor(powers([-90.0] * 40)) is None
    assert suspected_floor(powers([])) is None
    assert implausible_values(CHANNEL, powers([-70.0, -80.0]), 200.0) == ()
