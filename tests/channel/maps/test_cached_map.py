"""The cached map against the batch posterior, whatever it was fed before."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_channel import simulated, subset

from planopt.channel.maps.posterior_map import CachedMap
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import condition, extend
from planopt.errors import InputError

CHANNEL = ChannelParameters(-10.0, 2.0, 4.0, 10.0, 1.99, Station((25.0, 25.0)))
PLACES = np.random.default_rng(5).uniform(0.0, 50.0, (300, 2))


def agree(found, posterior):
    """With the posterior's own prediction, to 1e-10."""
    expected = posterior.predict(PLACES)
    np.testing.assert_allclose(found.mean_db, expected.mean_db, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(found.deviation_db, expected.deviation_db, rtol=1e-10)


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_one_by_one_equals_batch(monkeypatch, share):
    """After every step, past the growth of both buffers; repeated places included."""
    monkeypatch.setattr("planopt.channel.maps.posterior_map.COLUMNS", 128)
    data = simulated(CHANNEL, 1, 130, 50.0, share)
    data = subset(data, np.concatenate([np.arange(130), [3, 4]]))
    posterior = condition(CHANNEL, subset(data, np.arange(5)))
    cached = CachedMap(PLACES)
    for step in range(5, 132):
        posterior = extend(posterior, subset(data, np.arange(step, step + 1)))
        found = cached.refresh(posterior)
    agree(found, posterior)
    if not share:
        agree(found, condition(CHANNEL, data))


def test_only_new_rows_are_computed(monkeypatch):
    """An extended posterior needs the kernel of its new measurements alone."""
    data = simulated(CHANNEL, 2, 40, 50.0)
    first = condition(CHANNEL, subset(data, np.arange(30)))
    cached = CachedMap(PLACES)
    cached.refresh(first)
    from planopt.channel.maps import posterior_map

    asked = []
    kernel = posterior_map.covariance_db2
    monkeypatch.setattr(
        posterior_map,
        "covariance_db2",
        lambda a, b, parameters: asked.append(len(a.positions_m)) or kernel(a, b, parameters),
    )
    second = extend(first, subset(data, np.arange(30, 40)))
    agree(cached.refresh(second), second)
    assert asked == [10]
    agree(cached.refresh(second), second)
    assert asked == [10]


def test_anything_else_begins_anew():
    """Fewer measurements, other ones, other parameters, none."""
    data = simulated(CHANNEL, 3, 40, 50.0)
    other = simulated(CHANNEL, 4, 60, 50.0)
    cached = CachedMap(PLACES)
    for parameters, measurements in (
        (CHANNEL, data),
        (CHANNEL, subset(data, np.arange(20))),
        (CHANNEL, other),
        (replace(CHANNEL, decorrelation_m=4.0), other),
        (CHANNEL, subset(data, np.arange(0))),
        (CHANNEL, data),
    ):
        posterior = condition(parameters, measurements)
        agree(cached.refresh(posterior), posterior)


def test_predictions_are_the_callers():
    """A later refresh leaves an earlier prediction as it was."""
    data = simulated(CHANNEL, 3, 40, 50.0)
    first = condition(CHANNEL, subset(data, np.arange(30)))
    cached = CachedMap(PLACES)
    found = cached.refresh(first)
    cached.refresh(extend(first, subset(data, np.arange(30, 40))))
    agree(found, first)


def test_bad_places():
    """Positions that cannot be used."""
    with pytest.raises(InputError):
        CachedMap(np.zeros(3))
