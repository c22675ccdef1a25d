"""Obstacles that move on the way to a goal, and that come and go."""

import json
from dataclasses import replace

import numpy as np
import pytest
import shapely
from scenes import prepared_of, small_problem

import planopt
from planopt import InputError, MovingObstacle, Obstacle, Verdict, Workspace, check
from planopt.extend import Rung
from planopt.planning.free_space import leaving_path
from planopt.planning.loop.log import Outcome
from planopt.planning.solve import simulate
from planopt.problems import DoubleIntegrator, Unicycle, problem_from_dict, problem_to_dict
from planopt.problems.problem import problem_at
from planopt.world import NOTHING_MOVES, centres_at, index_obstacles

SHARES = np.linspace(0.0, 1.0, 201)
CROSSING = MovingObstacle("tram", 2.0, (0.0,), ((20.0, 5.0),), (0.0, 1.0))
ONCOMING = MovingObstacle("cart", 2.0, (0.0,), ((34.0, 15.0),), (-1.5, 0.0))
PARKING = MovingObstacle("van", 3.0, (0.0, 9.5, 20.0), ((25.0, 15.0), (20.0, 15.0), (20.0, 40.0)))
CORRIDOR = (shapely.box(8.0, 0.0, 32.0, 10.0), shapely.box(8.0, 20.0, 32.0, 30.0))


def driven(*moving, polygons=(), **changes):
    """A run beside moving obstacles, and how near it came to each by samples."""
    problem = small_problem(*polygons, **changes)
    problem = replace(problem, workspace=replace(problem.workspace, moving=moving))
    run = simulate(problem, prepared=prepared_of(problem))
    track = run.run.log.positions_m
    times = np.concatenate([k + SHARES for k in range(len(track) - 1)])
    places = np.stack([np.interp(times, range(len(track)), track[:, a]) for a in (0, 1)], axis=1)
    gaps = [
        np.linalg.norm(places - centres_at(one, times), axis=1).min() - one.radius_m
        for one in moving
    ]
    return run, gaps


@pytest.mark.parametrize("moving", [(CROSSING,), (ONCOMING,), (PARKING,), (CROSSING, ONCOMING)])
@pytest.mark.parametrize("planner", ["auto", "lattice"])
def test_the_goal_is_reached_past_what_moves(moving, planner):
    """Every step verified, and the clearance kept at all times."""
    run, gaps = driven(*moving, planner=planner)
    assert run.run.outcome is Outcome.REACHED
    assert all(plan.verdict is Verdict.VERIFIED for plan in run.plans[0])
    assert min(gaps) >= 0.5 - 1e-6
    least = min(plan.certificate.min_moving_clearance_m for plan in run.plans[0])
    assert 0.5 - 1e-6 <= least <= min(gaps) + 1e-6


def test_in_a_corridor_they_change_sides():
    """The only way leads past the oncoming cart, through the same corridor."""
    run, (gap,) = driven(ONCOMING, polygons=CORRIDOR, horizon=6)
    assert run.run.outcome is Outcome.REACHED
    assert gap >= 0.5 - 1e-6
    times = np.arange(len(run.run.log.t_s), dtype=float)
    ahead = centres_at(ONCOMING, times)[:, 0] - run.run.log.positions_m[:, 0]
    assert ahead[0] > 0.0 > ahead[-1]


def test_what_is_not_known_of_its_way_keeps_it_farther_away():
    """The certificate counts the disc as large as it is predicted."""
    unsure = replace(CROSSING, position_std_m=0.3, acceleration_std_m_s2=0.1)
    run, (gap,) = driven(unsure)
    assert run.run.outcome is Outcome.REACHED
    assert gap >= 0.5 + 0.3 * np.sqrt(-2.0 * np.log(0.005)) - 1e-6


def test_one_that_drives_over_a_robot_in_a_dead_end_is_owned_up_to():
    """Nothing can be verified; the certificate says what comes too near, and the run goes on."""
    cell = shapely.Polygon([(2, 2), (9, 2), (9, 8), (2, 8)], [[(4, 4), (6.5, 4), (6.5, 6), (4, 6)]])
    cart = MovingObstacle("press", 2.0, (0.0,), ((5.0, 12.0),), (0.0, -1.0))
    problem = small_problem(
        cell,
        bounds_m=(0.0, 0.0, 12.0, 12.0),
        start_m=(5.0, 5.0),
        goal_m=(5.5, 5.4),
        goal_radius_m=0.1,
        speed_max_m_s=0.2,
        max_steps=6,
        horizon=6,
    )
    problem = replace(problem, workspace=replace(problem.workspace, moving=(cart,)))
    run = simulate(problem, prepared=prepared_of(problem))
    assert any(
        "of the moving obstacle press" in reason
        for plan in run.plans[0]
        for reason in plan.certificate.reasons
    )
    assert run.run.verified_rate < 1.0


HOUSE = shapely.box(18.0, 10.0, 22.0, 20.0)
FENCE = shapely.box(25.0, 5.0, 26.0, 30.0)
"""Leaves a way round in the south only."""


def fenced(known_from_s, until_s=np.inf, polygon=FENCE, **options):
    """The small problem, from (5, 15) to (35, 15), and an obstacle that comes."""
    options = {"start_m": (5, 15), "goal_m": (35, 15), "max_steps": 60, **options}
    problem = small_problem(**options)
    fence = Obstacle("fence", polygon, known_from_s, until_s)
    return replace(problem, workspace=Workspace(problem.workspace.bounds_m, [fence]))


def fenced_run(problem):
    """Its run, and the lines that its robots drove."""
    run = simulate(problem, prepared=prepared_of(problem))
    return run, [shapely.LineString(one.log.positions_m) for one in run.runs]


def test_worlds_that_change():
    """A workspace tells what stands when; leaving an obstacle crosses no other one."""
    house, fence = Obstacle("house", HOUSE), Obstacle("fence", FENCE, 0.3, 0.7)
    gone = Obstacle("gone", HOUSE, 0.0, 0.2)
    workspace = Workspace((0, 0, 40, 30), [gone, house, fence])
    assert workspace.obstacles == (house, gone) and workspace.timed == (gone, fence)
    steps = [tuple(one.name for one in workspace.known_at(0.1 * k)) for k in range(9)]
    assert steps[:2] == [("house", "gone")] * 2 and steps[2] == steps[7] == ("house",)
    assert steps[3:7] == [("house", "fence")] * 4
    problem = small_problem(HOUSE, shapely.box(22.2, 10.0, 22.4, 20.0))
    index = index_obstacles(problem.workspace)
    path = leaving_path(problem, index, NOTHING_MOVES, np.array([21.5, 15.0]))
    assert path is None or path[0, 0] < 22.2
    touching = leaving_path(problem, index, NOTHING_MOVES, np.array([22.4, 15.0]))
    assert touching is None or touching[0, 0] >= 22.4


def test_a_plan_knows_only_what_stands_then():
    """Before it is known, plans are bit by bit those without it; then the way leads round."""
    problem = fenced(known_from_s=8.0)
    without = replace(problem, workspace=Workspace(problem.workspace.bounds_m))
    (later, (line,)), (never, _) = fenced_run(problem), fenced_run(without)
    step_s = problem.planner.step_s
    before = int(8.0 / step_s)
    for one, other in zip(later.plans[0][:before], never.plans[0][:before], strict=True):
        assert np.array_equal(one.positions_m, other.positions_m)
    assert not np.array_equal(
        later.plans[0][before].positions_m, never.plans[0][before].positions_m
    )
    assert (later.outcome, later.verified_rate) == (Outcome.REACHED, 1.0)
    assert line.distance(FENCE) >= problem.constraints.clearance_m
    assert line.length > 1.2 * shapely.LineString(never.runs[0].log.positions_m).length


def test_what_is_gone_is_in_nobodys_way():
    wall = shapely.box(25.0, 0.0, 26.0, 28.5)
    run, (line,) = fenced_run(fenced(0.0, until_s=4.0, polygon=wall))
    assert run.outcome is Outcome.REACHED and line.intersects(wall)
    assert (
        run.runs[0].metrics.goal_time_s
        < fenced_run(fenced(0.0, polygon=wall))[0].runs[0].metrics.goal_time_s
    )


def test_a_goal_that_is_cut_off_on_the_way_ends_the_run(tmp_path):
    """With the reason; the saved run is sound, and were the way left open, it would not be."""
    problem = planopt.load("open_field")
    goal = shapely.Point(problem.robots[0].goal_m)
    ring = Obstacle("ring", goal.buffer(8.0).difference(goal.buffer(6.0)), 6.0)
    workspace = replace(problem.workspace, timed=[ring])
    run = planopt.simulate(replace(problem, workspace=workspace), horizon=3, seed=1)
    assert run.outcome is Outcome.NO_PLAN and "separate" in run.reason
    assert len(run.plans[0]) == 3 and run.verified_rate == 1.0
    run.save(tmp_path)
    assert check(tmp_path).verdict is Verdict.VERIFIED
    file = tmp_path / "run.json"
    record = json.loads(file.read_text())
    record["problem_file"]["world"]["obstacles"][-1]["known_from_s"] = 60.0
    file.write_text(json.dumps(record))
    assert check(tmp_path).verdict is not Verdict.VERIFIED


def test_a_robot_in_a_new_obstacle_leaves_it_and_says_so():
    """By the nearest side, in several steps; these plans are not verified, the others are."""
    yard = shapely.box(5.0, 12.0, 35.0, 21.5)
    problem = fenced(3.0, polygon=yard, goal_m=(36.5, 25.0))
    run, _ = fenced_run(problem)
    assert run.outcome is Outcome.REACHED
    plans, track = run.plans[0], run.runs[0].log.positions_m
    first = int(3.0 / problem.planner.step_s)
    deep = shapely.distance(shapely.points(track), yard.boundary)
    deep = np.where(shapely.within(shapely.points(track), yard), deep, 0.0)
    left = [k for k, plan in enumerate(plans) if plan.rung is Rung.LEAVE]
    assert left and left == list(range(first, first + len(left)))
    assert (np.diff(deep[first : first + len(left) + 1]) < 0.0).all()
    assert deep[first + len(left) :].max() == 0.0
    for k, plan in enumerate(plans):
        assert (plan.verdict is Verdict.VERIFIED) == (k not in left)
    assert "clearance" in plans[first].message


def test_couriers_keep_apart_where_the_map_changes():
    """Two change places; a fence comes between them, and both go round it one after the other."""
    problem = fenced(4.0, polygon=shapely.box(19.0, 5.0, 20.0, 30.0))
    one = problem.robots[0]
    back = replace(one, name="back", start_m=one.goal_m, goal_m=one.start_m)
    constraints = replace(problem.constraints, separation_m=5.0)
    run, lines = fenced_run(replace(problem, robots=(one, back), constraints=constraints))
    assert (run.outcome, run.verified_rate) == (Outcome.REACHED, 1.0)
    assert run.metrics["min_separation_m"] >= 5.0 - 1e-6
    fence = problem.workspace.timed[0].polygon
    assert min(line.distance(fence) for line in lines) >= constraints.clearance_m - 1e-6


@pytest.mark.parametrize("dynamics", [Unicycle(2.0, 1.0), DoubleIntegrator(2.0, 1.0)])
def test_robots_with_dynamics_plan_round_it_as_well(dynamics):
    """They were on a way through it, can stop in time, and arrive."""
    problem = fenced(5.0)
    robot = replace(problem.robots[0], dynamics=dynamics, start_rest=())
    run, (line,) = fenced_run(replace(problem, robots=(robot,)))
    assert (run.outcome, run.verified_rate) == (Outcome.REACHED, 1.0)
    assert not line.intersects(FENCE)


def test_times_are_read_saved_and_checked():
    """As they were given; an end before the begin is named."""
    problem = fenced(3.0, until_s=9.0)
    tables = problem_to_dict(problem)
    again = problem_from_dict(tables)
    assert again.workspace == problem.workspace
    assert problem_at(again, 0).workspace.obstacles == ()
    assert len(problem_at(again, int(3.0 / again.planner.step_s)).workspace.obstacles) == 1
    tables["world"]["obstacles"][0]["until_s"] = 2.0
    with pytest.raises(InputError, match=r"world\.obstacles\[0\].*until_s"):
        problem_from_dict(tables)
    with pytest.raises(InputError, match="known_from_s = "):
        planopt.Problem(
            **{
                key: getattr(problem, key)
                for key in ("robots", "stations", "planner", "constraints", "channel")
            },
            workspace=Workspace((0, 0, 40, 30), [Obstacle("fence", FENCE, 5.0, 4.0)]),
        )
