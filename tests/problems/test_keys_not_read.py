"""Keys that the rest of a file leaves without a meaning are refused, and not saved."""

from __future__ import annotations

import copy

import pytest

from planopt.errors import InputError
from planopt.problems.save import problem_from_dict, problem_to_dict

TERM = {"kind": "mapping"}
CART = {"name": "cart", "radius_m": 1.0, "start_m": [25.0, 35.0], "velocity_m_s": [0.0, 1.0]}


@pytest.fixture
def mapping(tables):
    """The small problem, to be mapped."""
    tables["problem"]["task"] = "map"
    del tables["robots"][0]["goal_m"]
    tables["objective"] = {"terms": [dict(TERM)]}
    return tables


@pytest.mark.parametrize("form", [None, "information", "average"])
@pytest.mark.parametrize("key", ["variance_threshold_db2", "closeness_per_m"])
def test_mapping_forms_that_do_not_look_at_j_ch(form, key, mapping, built):
    """Their keys are for the forms path and two_layer."""
    built(mapping)
    term = mapping["objective"]["terms"][0]
    term |= {key: 0.0} | ({} if form is None else {"form": form})
    with pytest.raises(InputError, match=f'has {key}, which goes only with form = "path"'):
        built(mapping)


@pytest.mark.parametrize("form", ["path", "two_layer"])
def test_mapping_forms_that_do(form, mapping, built):
    """Read, saved and read again."""
    mapping["objective"]["terms"][0] |= {
        "form": form,
        "variance_threshold_db2": 2.0,
        "closeness_per_m": 0.1,
    }
    problem = built(mapping)
    assert problem_from_dict(problem_to_dict(problem)).objective == problem.objective


def test_one_term_steers(mapping, built):
    """A second form two_layer would have no place of its own."""
    mapping["objective"]["terms"] = [{**TERM, "form": "two_layer"}] * 2
    with pytest.raises(InputError, match="only one may have the form two_layer"):
        built(mapping)


def test_goal_radius_needs_a_goal(mapping, built):
    """There is none to be near to."""
    mapping["constraints"]["goal_radius_m"] = 2.0
    with pytest.raises(InputError, match=r"constraints\.goal_radius_m is for task reach"):
        built(mapping)


def test_probability_of_a_way_that_is_certain(mapping, built):
    """It says how much an uncertain one grows the disc."""
    sure = {**CART, "probability": 0.9}
    for moving in (CART, {**sure, "position_std_m": 0.1}, {**sure, "acceleration_std_m_s2": 0.1}):
        mapping["world"]["moving"] = [moving]
        problem = built(mapping)
        assert problem_from_dict(problem_to_dict(problem)).workspace == problem.workspace
    mapping["world"]["moving"] = [sure]
    with pytest.raises(InputError, match="has probability, which needs position_std_m or"):
        built(mapping)


def test_stated_times_that_no_run_comes_to(mapping, built):
    """One must be before the end of the longest run, or of the plan where that is longer."""
    mapping["planner"] |= {"horizon": 4, "max_steps": 6, "step_s": 0.5}
    rule = {"p_min": 0.9, "connectivity": "stated_times", "connected_times_s": [3.0, 5.0]}
    mapping["constraints"] |= rule
    built(mapping)
    late = copy.deepcopy(mapping)
    late["constraints"]["connected_times_s"] = [5.0, 3.5]
    with pytest.raises(InputError, match=r"begin with 3.5, and a run ends after 3 s") as caught:
        built(late)
    assert caught.value.key == "constraints.connected_times_s"
    late["planner"]["horizon"] = 7
    built(late)
