"""The worth of a released path does not depend on what else its search looked at."""

import pytest
from terms_scene import TRACKING, situation_of, terms_problem

import planopt.planning.proof.context as predictions
import planopt.planning.team.team_step as team_step
from planopt.planning.initial_data import team_seeds
from planopt.planning.team.team_step import build_team
from planopt.planning.values.context import Aim
from planopt.planning.values.objective_value import ObjectiveValue


@pytest.mark.parametrize("name", ["auto", "lattice", "one_step"])
def test_the_objective_is_the_paths_own(name, monkeypatch):
    """With few neighbours a place, grouped with others than the path's in the search."""
    for module in (predictions, team_step):
        monkeypatch.setattr(module, "SEARCH_EXACT_LIMIT", 10)
    monkeypatch.setattr(predictions, "SEARCH_NEIGHBOURS", 6)
    problem = terms_problem(TRACKING, name=name, p_min=0.6)
    situation, belief = situation_of(problem)
    member = build_team(problem, team_seeds(problem, 0))[0]
    plan, _ = member.plan(belief, member.start, Aim(situation.target_m, None), None)
    alone, _ = situation_of(problem)
    assert plan.objective == pytest.approx(ObjectiveValue(alone)(plan.positions_m[1:]), rel=1e-12)
