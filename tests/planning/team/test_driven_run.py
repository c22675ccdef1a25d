"""Closed loops of robots that cannot turn or stop at will; saved, and judged again from disk."""

import copy
from pathlib import Path

import numpy as np
import pytest
from terms_scene import LEARNING, TABLES, TRACKING

from planopt import Problem, Verdict
from planopt.extend import Rung
from planopt.planning.solve import simulate
from planopt.problems.problem import problem_from_tables


def random_scene(seed: int) -> Problem:
    """Some boxes, a robot of random dynamics at a random place, with or without a bound."""
    generator = np.random.default_rng(seed)
    tables = copy.deepcopy(TABLES)
    start = generator.uniform(3.0, 37.0, 2)
    boxes = []
    while len(boxes) < 5:
        (x, y), (w, h) = generator.uniform(5.0, 35.0, 2), generator.uniform(0.5, 5.0, 2)
        if max(abs(start[0] - x) - w, abs(start[1] - y) - h) > 1.0:
            boxes.append(
                {"polygon": [[x - w, y - h], [x + w, y - h], [x + w, y + h], [x - w, y + h]]}
            )
    tables["world"]["obstacles"] = boxes
    track = bool(generator.random() < 0.5)
    tables["objective"] = {"terms": [TRACKING if track else LEARNING]}
    tables["problem"]["task"] = "track" if track else "learn"
    if track:
        tables["targets"] = [
            {"start_m": [14.0, 18.0], "velocity_m_s": list(generator.normal(size=2))}
        ]
    tables["constraints"]["p_min"] = float(generator.choice([0.0, 0.6]))
    robot = {"start_m": start.tolist(), "speed_max_m_s": 2.0}
    if seed % 2:
        velocity = generator.uniform(-0.3, 0.3, 2).tolist()
        largest = float(generator.choice([0.3, 1.0]))
        robot |= {"dynamics": "double_integrator", "acceleration_max_m_s2": largest}
        robot["start_velocity_m_s"] = velocity
    else:
        rate = float(generator.choice([0.3, 1.0, 3.0]))
        robot |= {"dynamics": "unicycle", "turn_rate_max_rad_s": rate}
        robot["start_heading_rad"] = float(generator.uniform(0.0, 6.0))
    tables["robots"] = [robot]
    tables["planner"] |= {"horizon": int(generator.choice([1, 3, 5])), "max_steps": 6}
    return problem_from_tables(tables, folder=Path(), file=None)


@pytest.mark.parametrize("seed", range(4))
def test_every_released_plan_is_sound(seed: int) -> None:
    """Clear, driven, on a declared rung; what is not verified lacks connectivity alone."""
    problem = random_scene(seed)
    run = simulate(problem, seed=seed)
    state = problem.robots[0].start_state
    for plan in run.plans[0]:
        assert plan.drive.states[0] == pytest.approx(state, abs=1e-9)
        state = plan.drive.states[1]
        assert plan.rung in Rung
        assert plan.certificate.dynamics_defect <= 1e-5
        assert plan.certificate.min_clearance_m >= problem.constraints.clearance_m - 1e-6
        if plan.verdict is not Verdict.VERIFIED:
            assert all("p_min" in reason for reason in plan.certificate.reasons)
