"""Factors kept between steps against predictions from nothing."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from planopt.channel.kriging import predict
from planopt.channel.measurements import Measurements
from planopt.channel.nearest.near_factors import MOST_UNUSED, NearFactors
from planopt.channel.nearest.nearby import predict_nearby
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import ChannelPosterior, condition, extend

COUNT = 40


def measured(count: int, seed: int, side_m: float = 200.0) -> Measurements:
    """Random powers at random places."""
    generator = np.random.default_rng(seed)
    places = generator.uniform(0.0, side_m, (count, 2))
    power = -70.0 + 8.0 * generator.standard_normal(count)
    return Measurements(places, power, np.zeros(count, dtype=bool))


@pytest.fixture
def posterior() -> ChannelPosterior:
    """600 measurements without a common factor, theta known."""
    parameters = ChannelParameters(-20.0, 3.0, 8.0, 40.0, 2.0, Station((20.0, 30.0), 10.0))
    before = condition(parameters, measured(599, 3), theta="known", exact_limit=100)
    return extend(before, measured(1, 4))


def path(step: int) -> np.ndarray:
    """Eleven places 3 m apart; those of the next step are 3 m on and a little aside."""
    along = 3.0 * (step + np.arange(11.0))
    return np.column_stack([60.0 + along, 80.0 + 0.1 * step + 0.3 * along])


def test_never_less_informed_than_the_nearest(posterior):
    """Through a drive: variance between that of the nearest and that of all measurements."""
    full = condition(posterior.parameters, posterior.measurements, theta="known")
    for step in range(12):
        here = path(step)
        one = Measurements(here[:1], np.array([-65.0]), np.zeros(1, dtype=bool))
        posterior, full = extend(posterior, one), extend(full, one)
        kept = predict_nearby(posterior, here, COUNT, keep=True)
        alone = np.array(
            [predict_nearby(posterior, place[None], COUNT).deviation_db[0] for place in here]
        )
        exact = predict(full, here)
        assert (kept.deviation_db <= alone + 1e-9).all()
        assert (kept.deviation_db >= exact.deviation_db - 1e-9).all()
        # The means of a less and a better informed one differ by what the variances do.
        apart = np.sqrt(np.maximum(kept.deviation_db**2 - exact.deviation_db**2, 0.0))
        assert (np.abs(kept.mean_db - exact.mean_db) <= 5.0 * apart + 1e-6).all()


def test_groups_that_hold_everything_are_the_full_posterior(posterior):
    """With nearly all measurements asked for, mean and deviation are those of all."""
    few = condition(posterior.parameters, measured(60, 5), theta="known", exact_limit=20)
    few = extend(few, measured(1, 6))
    full = predict(condition(posterior.parameters, few.measurements, theta="known"), path(0))
    found = predict_nearby(few, path(0), 60, keep=True)
    np.testing.assert_allclose(found.mean_db, full.mean_db, atol=0.05)
    again = predict_nearby(few, path(0), 61, keep=True)
    np.testing.assert_allclose(again.mean_db, full.mean_db, atol=1e-9)
    np.testing.assert_allclose(again.deviation_db, full.deviation_db, atol=1e-9)


def test_two_posteriors_of_one_do_not_mix(posterior):
    """Each of two extensions has its own measurement under the same number."""
    for power in (-40.0, -95.0):
        one = Measurements(path(0)[:1], np.array([power]), np.zeros(1, dtype=bool))
        branch = extend(posterior, one)
        found = predict_nearby(branch, path(0), COUNT, keep=True)
        fresh = predict_nearby(replace(branch, near=None), path(0), COUNT)
        np.testing.assert_allclose(found.mean_db, fresh.mean_db, atol=0.1)


def test_a_branch_that_goes_on_is_served_by_its_own(posterior):
    """Two extensions in turns, each extended on: no group has a measurement of the other's."""
    near = posterior.near
    assert near is not None
    branches = [posterior, posterior]
    for step in range(4):
        for number, power in enumerate((-40.0, -95.0)):
            at = path(step)[2 + number][None]
            one = Measurements(at, np.array([power]), np.zeros(1, dtype=bool))
            branches[number] = extend(branches[number], one)
            for _ in range(1 + step % 2):
                served = near.serving(branches[number], path(step), COUNT)
                assert all(group.belongs_to(branches[number]) for group, _ in served)


def test_what_was_not_extended_keeps_nothing(posterior):
    """Two predictions from a conditioned posterior do not depend on each other."""
    fresh = condition(posterior.parameters, posterior.measurements, exact_limit=100)
    first = predict_nearby(fresh, path(1), COUNT, keep=True)
    predict_nearby(fresh, path(0), COUNT, keep=True)
    second = predict_nearby(fresh, path(1), COUNT, keep=True)
    np.testing.assert_array_equal(first.mean_db, second.mean_db)


def test_few_are_kept_and_none_is_pickled(posterior):
    """Groups do not pile up."""
    near = posterior.near
    assert near is not None
    for x in np.linspace(0.0, 200.0, 30):
        for y in (0.0, 100.0, 200.0):
            predict_nearby(posterior, np.array([[x, y]]), COUNT, keep=True)
    assert 0 < len(near) <= MOST_UNUSED + 1
    copy = pickle.loads(pickle.dumps(near))
    assert isinstance(copy, NearFactors) and len(copy) == 0
