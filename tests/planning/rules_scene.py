"""Problems under each rule of connectivity, and a small drawn channel where the rules bind."""

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

from scenes import small_problem
from terms_scene import TABLES, TRACKING

from planopt import ConnectivityRule, Constraints, Problem
from planopt.problems.problem import problem_from_tables

RULES: dict[str, dict[str, Any]] = {
    "each_step": {"p_min": 0.95, "connected_times_s": [2.0, 5.0]},
    "average": {"p_min": 0.93},
    "joint": {"p_min": 0.8},
    "outage": {"p_min": 0.95, "outage_max_m": 4.0},
    "data": {"p_min": 0.0, "data_mbit": 9.3, "deadline_s": 10.0, "rate_mbit_s": 1.0},
}
"""Of the small problem of `terms_scene` at seed 3: the best plan without a rule keeps none."""


def ruled_problem(form: str, **keys: Any) -> Problem:
    """The small tracking problem under a rule; `keys` of constraints besides."""
    tables = copy.deepcopy(TABLES)
    tables["problem"]["task"] = "track"
    tables["objective"] = {"terms": [dict(TRACKING)]}
    tables["targets"] = [{"start_m": [14.0, 18.0], "velocity_m_s": [0.9, 0.2]}]
    tables["constraints"] |= {"connectivity": form, **RULES.get(form, {}), **keys}
    return problem_from_tables(tables, folder=Path(), file=None)


def hand_made(form: str, p_min: float = 0.9, **rule: Any) -> Problem:
    """The hand-made problem of `scenes` under a rule."""
    problem = small_problem()
    asked = ConnectivityRule(form, **rule)
    return replace(problem, constraints=Constraints(p_min=p_min, clearance_m=0.5, rule=asked))
