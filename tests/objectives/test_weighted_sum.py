"""Weighted sums: linear, signs as given, additive only where every term is."""

from functools import partial

import numpy as np
import pytest
from path_scene import CHANNEL, PATH, START, drawn

from planopt.channel.posterior import condition
from planopt.errors import InputError
from planopt.objectives.energy import (
    Motion,
    Radio,
    motion_energy_j,
    transmission_energy_j,
    transmission_stage_costs_j,
)
from planopt.objectives.mapping import path_information
from planopt.objectives.tracking import Tracking, tracking_stage_rewards, tracking_value
from planopt.objectives.weighted_sum import Term, weighted_stage_rewards, weighted_sum
from planopt.targets.sensor import Sensor

POSTERIOR = condition(CHANNEL, drawn(15))
TRACKING = Tracking(-73.0, Sensor(0.008, 0.08, 1.0), PATH + 2.0)
RADIO = Radio(2.0, 1e-6, -100.0, 20.0, 0.5)
MOTION = Motion(3.5, 0.3, 2.0, START)
TERMS = [
    Term(
        "tracking",
        2.0,
        partial(tracking_value, settings=TRACKING),
        lambda posterior, places, stage: tracking_stage_rewards(posterior, places, stage, TRACKING),
    ),
    Term(
        "transmission",
        -0.5,
        partial(transmission_energy_j, settings=RADIO),
        lambda posterior, places, stage: transmission_stage_costs_j(posterior, places, RADIO),
    ),
]
NOT_ADDITIVE = Term("mapping", 0.1, partial(path_information, universal=True))


def test_total_is_the_weighted_sum_of_the_terms():
    """Values are kept unweighted, by name."""
    motion = Term("motion", -0.01, lambda posterior, path: motion_energy_j(path, MOTION))
    found = weighted_sum([*TERMS, NOT_ADDITIVE, motion], POSTERIOR, PATH)
    assert list(found.terms) == ["tracking", "transmission", "mapping", "motion"]
    assert found.terms["tracking"] == tracking_value(POSTERIOR, PATH, TRACKING)
    expected = np.dot([2.0, -0.5, 0.1, -0.01], list(found.terms.values()))
    assert found.total == pytest.approx(expected)


def test_stage_rewards_add_up_to_the_value():
    """Along a path the stages of additive terms sum to the total."""
    stages = [weighted_stage_rewards(TERMS, POSTERIOR, PATH[k : k + 1], k)[0] for k in range(5)]
    assert sum(stages) == pytest.approx(weighted_sum(TERMS, POSTERIOR, PATH).total)


def test_what_is_no_sum_over_stages_is_named():
    """The message has the term."""
    with pytest.raises(InputError, match="mapping"):
        weighted_stage_rewards([*TERMS, NOT_ADDITIVE], POSTERIOR, PATH, 0)


@pytest.mark.parametrize("terms", [[], [NOT_ADDITIVE, NOT_ADDITIVE]])
def test_no_terms_or_two_of_a_name(terms):
    """Both are refused."""
    with pytest.raises(InputError):
        weighted_sum(terms, POSTERIOR, PATH)
