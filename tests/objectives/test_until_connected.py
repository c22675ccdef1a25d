"""Expected distance until connected: simulation, independence, repeated places."""

import numpy as np
import pytest
from path_scene import CHANNEL, PATH, START, drawn

from planopt.channel import condition, first_passage, joint_prediction, sample_power
from planopt.channel.kriging import connection_probability, predict
from planopt.objectives.terms.until_connected import (
    Search,
    charged_distance_m,
    charged_distances_m,
    filtered_failing,
    passage_programme,
)

POSTERIOR = condition(CHANNEL, drawn(15))
THRESHOLD = float(np.median(predict(POSTERIOR, PATH).mean_db)) + 2.0
WHOLE = np.vstack([START, PATH])
LEGS = np.linalg.norm(np.diff(WHOLE, axis=0), axis=1)


def test_charged_distance_by_driving_through_sampled_channels():
    """Mean of 40,000 drives, each charged if it ends without connection; always the same number."""
    search = Search(START, (THRESHOLD,), beyond_m=50.0)
    found = charged_distance_m([POSTERIOR], PATH, search)
    assert found == charged_distance_m([POSTERIOR], PATH, search)
    up = sample_power(POSTERIOR, PATH, 40_000, np.random.default_rng(1)) >= THRESHOLD
    searching = np.cumprod(~up, axis=1)
    driven = LEGS[0] + searching @ np.append(LEGS[1:], 50.0)
    assert found == pytest.approx(driven.mean(), rel=0.04)


def test_positions_that_are_no_probes_are_passed():
    """As if the path had only the others, with the same legs."""
    search = Search(START, (THRESHOLD,), beyond_m=50.0)
    probed = np.arange(len(PATH)) % 2 == 1
    found = charged_distance_m([POSTERIOR], PATH, search, probed=probed)
    power = joint_prediction(POSTERIOR, PATH[probed])
    failing = np.ones(len(PATH) + 1)
    above = (power.mean_db - THRESHOLD)[None]
    some = filtered_failing(above, power.covariance_db2[None])[0]
    failing[1:] = np.concatenate([[1.0], np.repeat(some, 2)])[: len(PATH)]
    assert found == pytest.approx(LEGS @ failing[:-1] + 50.0 * failing[-1], rel=1e-12)
    none = charged_distance_m([POSTERIOR], PATH, search, probed=np.zeros(len(PATH), dtype=bool))
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
    search = Search(START, (THRESHOLD,), beyond_m=7.0)
    expected = LEGS[0] + 7.0 * (1.0 - p)
    assert charged_distance_m([POSTERIOR], PATH[:1], search) == pytest.approx(expected, rel=1e-9)
    mean = (power.mean_db - THRESHOLD)[None]
    covariance = (power.deviation_db**2)[None, None]
    filtered = charged_distances_m([(mean, covariance)], LEGS[None, :1], 7.0)
    assert filtered == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_filtering_is_near_the_integral(seed):
    """Within 4 % for winding paths, many at once."""
    rng = np.random.default_rng(seed)
    paths = np.asarray(START) + np.cumsum(rng.normal(1.0, 2.0, (3, 8, 2)), axis=1)
    search = Search(START, (THRESHOLD,), beyond_m=30.0)
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
    for path, end, one in zip(paths, ends, filtered, strict=True):
        passage = first_passage(POSTERIOR, end, THRESHOLD, np.random.default_rng(0))
        true = passage.expected_distance_m + 30.0 * passage.not_connected[-1]
        assert one == pytest.approx(true, rel=0.04)
        assert charged_distance_m([POSTERIOR], path, search) == pytest.approx(one, rel=1e-9)
