"""A goal that no way leads to: the key that is at odds, and the least change that opens one."""

from dataclasses import replace
from time import process_time

import numpy as np
import pytest
import shapely
from scenes import belief_of, small_problem

from planopt import NoPlanError, Obstacle, Plan, Problem, Verdict, Workspace, explain, load
from planopt.planning.certificate import Relaxation
from planopt.planning.explain.changes import EXPLAINED_S, Trials
from planopt.planning.explain.explain import explain_no_path, widest_clearance_m
from planopt.planning.free_space import is_joined
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import build_scene


def planned(problem: Problem) -> Plan | None:
    try:
        scene = build_scene(problem)
    except NoPlanError:
        return None
    start = np.asarray(problem.robots[0].start_m)
    return ReachPlanner(problem, scene).plan(belief_of(problem), start)


def explained(problem: Problem) -> dict[str, Relaxation]:
    """The changes that open a path, by key."""
    joined = is_joined(problem, problem.constraints.clearance_m)
    found = explain_no_path(problem, Trials(planned, process_time() + EXPLAINED_S), joined)
    return {one.constraint: one for one in found}


def corridor(width_m: float, clearance_m: float, **options) -> Problem:
    """Two blocks with a corridor about y = 15, which the lattice has a row in the middle of."""
    low, high = 15.0 - 0.5 * width_m, 15.0 + 0.5 * width_m
    blocks = shapely.box(12, -1, 28, low), shapely.box(12, high, 28, 31)
    return small_problem(*blocks, clearance_m=clearance_m, **options)


def with_clearance(problem: Problem, clearance_m: float) -> Problem:
    return replace(problem, constraints=replace(problem.constraints, clearance_m=clearance_m))


@pytest.mark.parametrize(("width_m", "clearance_m"), [(4.0, 2.5), (1.0, 0.8), (6.0, 4.5)])
def test_corridor_of_known_width(width_m, clearance_m):
    """Half the width would do: it is verified, and with 5 % less relaxation it is not."""
    problem = corridor(width_m, clearance_m)
    assert planned(problem) is None
    found = explained(problem)
    said = found["constraints.clearance_m"]
    assert said.value == clearance_m and said.unit == said.shortfall_unit == "m"
    assert said.relaxed_value <= 0.5 * width_m
    assert said.relaxed_value == pytest.approx(0.5 * width_m, abs=3e-3)
    assert said.shortfall == pytest.approx(clearance_m - said.relaxed_value)
    assert said.verified
    open_ = planned(with_clearance(problem, said.relaxed_value))
    assert open_ is not None and open_.verdict is Verdict.VERIFIED
    almost = clearance_m - 0.95 * (clearance_m - said.relaxed_value)
    assert planned(with_clearance(problem, almost)) is None
    assert "constraints.clearance_m" in str(said) and "would suffice (confirmed" in str(said)


def test_widest_clearance_by_hand():
    """Of two gates the wider one counts; none where the goal is walled in."""
    walls = shapely.box(19, -1, 20, 8), shapely.box(19, 9, 20, 20), shapely.box(19, 23, 20, 31)
    problem = small_problem(*walls, clearance_m=2.0)
    assert widest_clearance_m(problem) == pytest.approx(1.5, abs=1e-3)
    assert is_joined(problem, 1.49) and not is_joined(problem, 1.51)
    assert widest_clearance_m(with_clearance(problem, 1.0)) == pytest.approx(1.0, abs=1e-3)
    shut = small_problem(shapely.box(19, -1, 20, 31))
    assert widest_clearance_m(shut) is None


def test_goal_that_is_walled_in():
    """No clearance helps, only the one obstacle that shuts it in can go."""
    room = shapely.Polygon(
        [(30, 10), (39, 10), (39, 20), (30, 20)], [[(31, 11), (38, 11), (38, 19), (31, 19)]]
    )
    problem = small_problem(shapely.box(10, 5, 12, 25), room)
    (said,) = explained(problem).values()
    assert said.constraint == "world.obstacles (obstacle 1)"
    assert said.value is None and said.relaxed_value is None and said.verified
    assert "without this obstacle there is a plan" in str(said)


def test_steps_too_long_for_the_lattice():
    """A slot between the nodes: shorter steps find it, and so does a smaller clearance."""
    walls = shapely.box(19.0, 0.0, 21.0, 14.31), shapely.box(19.0, 15.33, 21.0, 30.0)
    problem = small_problem(*walls)
    found = explained(problem)
    assert set(found) == {"constraints.clearance_m", "planner.step_s"}
    assert all(relaxation.verified for relaxation in found.values())
    assert found["constraints.clearance_m"].relaxed_value < 0.5
    assert found["planner.step_s"].relaxed_value < 1.0


@pytest.mark.slow
def test_ten_thousand_obstacles_are_explained_in_time():
    problem = load("open_field")
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    ends = np.array([problem.robots[0].start_m, problem.goal_m])
    x, y = np.meshgrid(np.linspace(x_min, x_max, 101), np.linspace(y_min, y_max, 101))
    centres = np.column_stack([x.ravel(), y.ravel()])
    away = np.linalg.norm(centres[:, None] - ends, axis=2).min(axis=1)
    obstacles = [
        Obstacle(f"o{number}", shapely.Point(place).buffer(0.2, quad_segs=1))
        for number, place in enumerate(centres[away > 4.0])
    ]
    many = replace(problem, workspace=Workspace(problem.workspace.bounds_m, obstacles))
    begun = process_time()
    said = explain(many)
    assert process_time() - begun < 10.0
    assert said.summary.startswith("There is no plan")
