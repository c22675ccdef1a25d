"""The key ``channel.calibration``: what it goes with, and that saving keeps it."""

from __future__ import annotations

import pytest

from planopt.errors import InputError
from planopt.problems.save import problem_from_dict, problem_to_dict


@pytest.mark.parametrize("name", ["none", "platt"])
def test_read_and_saved(name, tables, built):
    """As given, and none if it is not."""
    assert built(tables).channel.calibration == "none"
    tables["channel"]["calibration"] = name
    problem = built(tables)
    assert problem.channel.calibration == name
    assert problem_from_dict(problem_to_dict(problem)).channel == problem.channel


def test_unknown_kind(tables, built):
    """The message names the key and the kinds."""
    tables["channel"]["calibration"] = "magic"
    with pytest.raises(InputError, match=r"none.*platt") as caught:
        built(tables)
    assert caught.value.key == "channel.calibration"


TERMS = {
    "until connected": ("connect", {"kind": "until_connected"}, "whole path"),
    "sampled": (
        "track",
        {
            "kind": "tracking",
            "form": "sampled",
            "sweet_spot_m": 5.0,
            "noise_curvature": 1e-3,
            "noise_floor_m2": 0.1,
        },
        "sampled",
    ),
}


@pytest.mark.parametrize("name", TERMS)
def test_terms_on_whole_paths_are_refused(name, tables, built):
    """They rest on the joint normal law; without calibration they are taken."""
    task, term, words = TERMS[name]
    del tables["robots"][0]["goal_m"]
    tables["problem"]["task"] = task
    tables["objective"] = {"terms": [term]}
    if task == "track":
        tables["targets"] = [{"start_m": [20.0, 30.0], "velocity_m_s": [0.1, 0.0]}]
    else:
        del tables["constraints"]["p_min"]
    built(tables)
    tables["channel"]["calibration"] = "platt"
    with pytest.raises(InputError, match=words) as caught:
        built(tables)
    assert caught.value.key == "channel.calibration" and caught.value.remedy


def test_uncertain_parameters_besides_are_refused(tables, built):
    """Outcomes count that already."""
    tables["constraints"]["parameter_uncertainty"] = "all"
    built(tables)
    tables["channel"]["calibration"] = "platt"
    with pytest.raises(InputError, match="parameter_uncertainty") as caught:
        built(tables)
    assert caught.value.key == "channel.calibration"
