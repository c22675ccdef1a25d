"""A gap without connection, and a moving obstacle that cannot be dodged."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from relaxed import shorter, with_value
from silent_field import TABLES, belief_in

from planopt import Problem, Verdict, explain
from planopt.channel.kriging import predict
from planopt.planning.certificate import required_margins_db
from planopt.planning.solve import solve_on
from planopt.problems.problem import problem_from_tables

GOOD_DBM, BAD_DBM = -60.0, -100.0
READINGS_M = np.stack(np.meshgrid(np.arange(11.0, 50.0, 2.0), np.arange(9.0, 32.0, 2.0)), -1)
PLACES_M = READINGS_M.reshape(-1, 2)


def field_problem(**tables) -> Problem:
    """One robot that asks for connection at each step; `tables` are put over the silent field's."""
    asked = copy.deepcopy(TABLES)
    asked["constraints"]["p_min"] = 0.9
    asked["stations"][0]["threshold_dbm"] = -80.0
    for name, table in tables.items():
        if isinstance(table, dict):
            asked[name] |= table
        else:
            asked[name] = table
    return problem_from_tables(asked, folder=Path(), file=None)


def robots(*starts_m: tuple[float, float], **own) -> list[dict]:
    return [
        {"name": f"r{number}", "start_m": list(start), "speed_max_m_s": 2.0, **own}
        for number, start in enumerate(starts_m)
    ]


def belief_where(problem: Problem, is_good):
    """Readings every 2 m: connected where `is_good(x, y)`, and the change half-way between."""
    power = np.where(is_good(PLACES_M[:, 0], PLACES_M[:, 1]), GOOD_DBM, BAD_DBM)
    return belief_in(
        problem,
        PLACES_M,
        power,
        k_pl_db=-80.0,
        n_pl=0.0,
        shadow_std_db=8.0,
        decorrelation_m=20.0,
        multipath_std_db=0.3,
    )


def edge_m(problem: Problem, belief, from_x_m: float) -> float:
    """How far right of a place on y = 20 the bound is first kept."""
    x = np.arange(from_x_m, 60.0, 0.005)
    power = predict(belief.posterior, np.stack([x, np.full_like(x, 20.0)], axis=1))
    return float(x[np.argmax(required_margins_db(problem, power) >= 0.0)] - from_x_m)


def is_least(problem: Problem, belief, one) -> None:
    """Verified with the value that is proposed, not with 5 % less of it."""
    assert one.verified
    changed = with_value(problem, one.constraint, one.relaxed_value)
    assert solve_on(changed, belief, 0).verdict is Verdict.VERIFIED
    less = with_value(problem, one.constraint, shorter(one.value, one.relaxed_value))
    assert solve_on(less, belief, 0).verdict is Verdict.VIOLATED


def said_of(problem: Problem, belief) -> dict:
    solution = solve_on(problem, belief, 0)
    assert solution.verdict is Verdict.VIOLATED
    return {one.constraint: one for one in explain(solution)}


def test_outage_of_a_gap_of_known_width():
    """From the middle of a gap of 14 m: so many steps to its edge, the last of them connected."""
    problem = field_problem(
        robots=robots((20.0, 20.0)),
        constraints={"p_min": 0.9, "connectivity": "outage", "outage_max_s": 1.0},
        planner={"horizon": 6, "step_s": 1.0},
    )
    belief = belief_where(problem, lambda x, _: (x < 13.0) | (x > 27.0))
    away = edge_m(problem, belief, 20.0)
    steps = int(np.ceil(away / 2.0))
    assert steps >= 3
    said = said_of(problem, belief)
    one = said["constraints.outage_max_s"]
    assert one.shortfall == steps - 2.0 and one.shortfall_unit == "s"
    assert one.stages == tuple(range(1, steps))
    assert steps - 1.0 <= one.relaxed_value <= steps - 1.0 + 0.03 * (steps - 2.0)
    is_least(problem, belief, one)


def test_moving_obstacle_that_cannot_be_dodged():
    """Too wide and too fast: by how much, and what would have to be otherwise."""
    problem = field_problem(
        robots=robots((30.0, 20.0)),
        constraints={"p_min": 0.9, "clearance_m": 2.0},
        planner={"horizon": 4, "step_s": 1.0},
        world={
            "bounds_m": [0.0, 0.0, 60.0, 40.0],
            "moving": [
                {
                    "name": "tram",
                    "radius_m": 6.0,
                    "start_m": [10.0, 20.0],
                    "velocity_m_s": [6.0, 0.0],
                }
            ],
        },
    )
    belief = belief_where(problem, lambda x, _: x > -1.0)
    solution = solve_on(problem, belief, 0)
    assert solution.verdict is Verdict.VIOLATED
    said = {one.constraint: one for one in explain(solution)}
    found = solution.plans[0].certificate.min_moving_clearance_m
    one = said["constraints.clearance_m"]
    assert one.shortfall == pytest.approx(2.0 - found) and one.shortfall_unit == "m"
    gone = said["world.moving (tram)"]
    assert gone.verified and gone.value is None and gone.relaxed_value is None
    rest = replace(problem, workspace=replace(problem.workspace, moving=()))
    assert solve_on(rest, belief, 0).verdict is Verdict.VERIFIED
