"""Expected distance until connected: simulation, independence, repeated places."""

import numpy as np
import pytest
from path_scene import CHANNEL, NOTHING, PATH, START, drawn

from planopt.channel.connection.first_passage import first_passage
from planopt.channel.joint import joint_prediction, sample_power
from planopt.channel.kriging import predict
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import condition
from planopt.channel.prediction import connection_probability
from planopt.errors import InputError
from planopt.objectives.passage_programme import passage_programme
from planopt.objectives.until_connected import (
    Search,
    charged_distance_m,
    charged_distances_m,
    expected_distance_m,
    filtered_failing,
    independent_expected_distance_m,
)

POSTERIOR = condition(CHANNEL, drawn(15))
THRESHOLD = float(np.median(predict(POSTERIOR, PATH).mean_db)) + 2.0
WHOLE = np.vstack([START, PATH])
LEGS = np.linalg.norm(np.diff(WHOLE, axis=0), axis=1)


@pytest.mark.parametrize("now", [True, False])
def test_by_driving_through_sampled_channels(now):
    """Mean distance of 40,000 drives within 5 standard errors."""
    search = Search(START, THRESHOLD, disconnected_now=now)
    found = expected_distance_m(POSTERIOR, PATH, search, np.random.default_rng(0))
    up = sample_power(POSTERIOR, WHOLE, 40_000, np.random.default_rng(1)) >= THRESHOLD
    if now:
        up = up[~up[:, 0]]
    searching = np.cumprod(~up[:, 1:-1], axis=1)
    driven = LEGS[0] + searching @ LEGS[1:]
    assert abs(driven.mean() - found) < 5.0 * driven.std() / np.sqrt(len(driven))


def test_independent_places_agree():
    """With a decorrelation distance far below the legs both are the same product."""
    white = ChannelParameters(-35.0, 2.8, 5.0, 1e-3, 2.0, Station((3.0, -4.0), 6.0))
    posterior = condition(white, NOTHING, theta="known")
    power = predict(posterior, PATH)
    threshold = float(power.mean_db.mean())
    failing = 1.0 - connection_probability(power.mean_db, power.deviation_db, threshold)
    expected = LEGS @ np.concatenate([[1.0], np.cumprod(failing[:-1])])
    search = Search(START, threshold)
    found = expected_distance_m(posterior, PATH, search, np.random.default_rng(0))
    assert found == pytest.approx(expected, rel=1e-3)
    assert independent_expected_distance_m(posterior, PATH, search) == pytest.approx(expected)


def test_independence_promises_too_much():
    """Positively correlated places fail together."""
    search = Search(START, THRESHOLD, disconnected_now=False)
    joint = expected_distance_m(POSTERIOR, PATH, search, np.random.default_rng(0))
    assert independent_expected_distance_m(POSTERIOR, PATH, search) < joint


@pytest.mark.parametrize("now", [True, False])
def test_a_place_that_repeats_counts_once(now):
    """Going to and fro: the second visit is no new trial; the start is one only if unknown."""
    to_and_fro = np.array([PATH[0], START, PATH[0], PATH[1]])
    search = Search(START, THRESHOLD, disconnected_now=now)
    q = 1.0 - POSTERIOR.connectivity(np.vstack([START, PATH[0]]), THRESHOLD)
    back = 1.0 if now else q[0]
    legs = np.array([LEGS[0], LEGS[0], LEGS[0], LEGS[1]])
    expected = legs @ [1.0, q[1], q[1] * back, q[1] * back]
    found = independent_expected_distance_m(POSTERIOR, to_and_fro, search)
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("threshold, expected", [(-500.0, LEGS[0]), (500.0, LEGS.sum())])
def test_extremes(threshold, expected):
    """Connected everywhere: the first leg; nowhere: the whole path."""
    search = Search(START, threshold, disconnected_now=False)
    joint = expected_distance_m(POSTERIOR, PATH, search, np.random.default_rng(0))
    assert joint == pytest.approx(expected)
    assert independent_expected_distance_m(POSTERIOR, PATH, search) == pytest.approx(expected)


def test_impossible_condition_and_bad_paths():
    """Certain to be connected at the start; no path."""
    with pytest.raises(InputError, match="certain"):
        expected_distance_m(POSTERIOR, PATH, Search(START, -500.0), np.random.default_rng(0))
    with pytest.raises(InputError):
        independent_expected_distance_m(POSTERIOR, PATH[:0], Search(START, THRESHOLD))


def test_charged_distance_by_driving_through_sampled_channels():
    """Mean of 40,000 drives, each charged if it ends without connection; always the same number."""
    search = Search(START, THRESHOLD, disconnected_now=False, beyond_m=50.0)
    found = charged_distance_m(POSTERIOR, PATH, search)
    assert found == charged_distance_m(POSTERIOR, PATH, search)
    up = sample_power(POSTERIOR, PATH, 40_000, np.random.default_rng(1)) >= THRESHOLD
    searching = np.cumprod(~up, axis=1)
    driven = LEGS[0] + searching @ np.append(LEGS[1:], 50.0)
    assert found == pytest.approx(driven.mean(), rel=0.04)


def test_places_that_are_no_tries_are_driven_past():
    """As if the path had only the others, with the same legs."""
    search = Search(START, THRESHOLD, disconnected_now=False, beyond_m=50.0)
    tried = np.arange(len(PATH)) % 2 == 1
    found = charged_distance_m(POSTERIOR, PATH, search, tried=tried)
    power = joint_prediction(POSTERIOR, PATH[tried])
    failing = np.ones(len(PATH) + 1)
    above = (power.mean_db - THRESHOLD)[None]
    some = filtered_failing(above, power.covariance_db2[None])[0]
    failing[1:] = np.concatenate([[1.0], np.repeat(some, 2)])[: len(PATH)]
    assert found == pytest.approx(LEGS @ failing[:-1] + 50.0 * failing[-1], rel=1e-12)
    none = charged_distance_m(POSTERIOR, PATH, search, tried=np.zeros(len(PATH), dtype=bool))
    assert none == pytest.approx(LEGS.sum() + 50.0, rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_solvers_have_the_same_formula(seed):
    """Filtered by CasADi and by NumPy, of two stations."""
    rng = np.random.default_rng(seed)
    mean = rng.normal(-1.0, 3.0, (2, 5))
    root = rng.normal(size=(2, 5, 5))
    covariance = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(5)
    legs, beyond = rng.uniform(0.0, 4.0, 5), 20.0
    each = [(mean[own][None], covariance[own][None]) for own in range(2)]
    z = [part.ravel() for own in range(2) for part in (mean[own], covariance[own])]
    value = passage_programme(5, 2).value(np.concatenate([*z, legs, [beyond]]))
    expected = charged_distances_m(each, legs[None], beyond)[0]
    assert float(value) == pytest.approx(expected, rel=1e-12)


def test_one_step_is_charged_exactly():
    """Its length, and the rest if it is not connected there."""
    power = predict(POSTERIOR, PATH[:1])
    p = connection_probability(power.mean_db, power.deviation_db, THRESHOLD)[0]
    search = Search(START, THRESHOLD, disconnected_now=False, beyond_m=7.0)
    expected = LEGS[0] + 7.0 * (1.0 - p)
    assert charged_distance_m(POSTERIOR, PATH[:1], search) == pytest.approx(expected, rel=1e-9)
    mean = (power.mean_db - THRESHOLD)[None]
    covariance = (power.deviation_db**2)[None, None]
    filtered = charged_distances_m([(mean, covariance)], LEGS[None, :1], 7.0)
    assert filtered == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_filtering_is_near_the_integral(seed):
    """Within 4 %, and far nearer than independence, for winding paths, many at once."""
    rng = np.random.default_rng(seed)
    paths = np.asarray(START) + np.cumsum(rng.normal(1.0, 2.0, (3, 8, 2)), axis=1)
    search = Search(START, THRESHOLD, disconnected_now=False, beyond_m=30.0)
    powers = [joint_prediction(POSTERIOR, path) for path in paths]
    ends = np.concatenate([np.tile(START, (3, 1, 1)), paths], axis=1)
    filtered = charged_distances_m(
        [
            (
                np.array([power.mean_db for power in powers]) - THRESHOLD,
                np.array([power.covariance_db2 for power in powers]),
            )
        ],
        np.linalg.norm(np.diff(ends, axis=1), axis=2),
        30.0,
    )
    for path, end, power, one in zip(paths, ends, powers, filtered, strict=True):
        passage = first_passage(POSTERIOR, end, THRESHOLD, np.random.default_rng(0))
        true = passage.expected_distance_m + 30.0 * passage.not_connected[-1]
        assert one == pytest.approx(true, rel=0.04)
        assert charged_distance_m(POSTERIOR, path, search) == pytest.approx(one, rel=1e-9)
        deviation = np.sqrt(np.diag(power.covariance_db2))
        failing = 1.0 - connection_probability(power.mean_db, deviation, THRESHOLD)
        independent = independent_expected_distance_m(POSTERIOR, path, search)
        independent += 30.0 * failing.prod()
        assert abs(one - true) < 0.25 * abs(independent - true)
