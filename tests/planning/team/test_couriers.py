"""Robots with goals of their own: they keep apart, give way, and all arrive."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import shapely
from scenes import BAD, GOOD, prepared_of, small_problem

import planopt
from planopt.extend import Rung
from planopt.planning.loop.log import Outcome
from planopt.planning.solve import simulate

SEPARATION_M = 5.0
BELOW = shapely.box(8, 0, 32, 13)
STREET = (BELOW, shapely.box(8, 17, 32, 30))
"""A street 4 m wide: nobody passes anybody in it."""
NICHE = (BELOW, shapely.box(8, 17, 32, 30).difference(shapely.box(18, 17, 23, 24)))
"""The same with a place to step aside."""
DEAD_END = (shapely.box(8, 0, 40, 13), shapely.box(8, 17, 40, 30))

SCENES = {
    "they change places in the open": ((), [((5, 15), (35, 15)), ((35, 15), (5, 15))]),
    "they meet in a street with a niche": (NICHE, [((4, 15), (36, 15)), ((36, 15), (4, 15))]),
    "both are in the street": (STREET, [((11, 15), (36, 15)), ((29, 15), (4, 15))]),
    "one stops in the way of the other": (NICHE, [((13, 15), (20.5, 15)), ((4, 15), (36, 15))]),
    "one makes this infeasible already": (NICHE, [((20.5, 15), (20.5, 15)), ((4, 15), (36, 15))]),
    "the nearer goal shuts the farther one in": (
        DEAD_END,
        [((4, 10), (12, 15)), ((4, 28), (36, 15))],
    ),
    "the inner goal shuts the outer one in": (
        DEAD_END,
        [((36, 15), (12, 15)), ((12, 15), (36, 15))],
    ),
    "four cross": (
        (),
        [((5, 5), (35, 25)), ((35, 25), (5, 5)), ((5, 25), (35, 5)), ((35, 5), (5, 25))],
    ),
}


def couriers(polygons, ends, **options):
    """The small problem with a robot for each start and goal."""
    options = {"max_steps": 60} | options
    one = small_problem(*polygons, start_m=ends[0][0], goal_m=ends[0][1], **options)
    robots = tuple(
        replace(one.robots[0], name=f"courier{k}", start_m=start, goal_m=goal)
        for k, (start, goal) in enumerate(ends)
    )
    constraints = replace(one.constraints, separation_m=SEPARATION_M)
    return replace(one, robots=robots, constraints=constraints)


def driven(problem):
    """Where its robots are at many times of a run: they drive straight during a step."""
    run = simulate(problem, prepared=prepared_of(problem))
    share = np.linspace(0.0, 1.0, 21)[:, None, None]
    tracks = [one.log.positions_m for one in run.runs]
    return run, [((1.0 - share) * track[:-1] + share * track[1:]) for track in tracks]


def least_m(tracks):
    """Least distance of any two, by sampling."""
    return min(np.linalg.norm(a - b, axis=-1).min() for a, b in combinations(tracks, 2))


@pytest.mark.parametrize("name", SCENES)
def test_all_arrive_and_none_comes_too_near(name):
    """Each would arrive alone; together they would meet, and some give way."""
    polygons, ends = SCENES[name]
    problem = couriers(polygons, ends)
    run, tracks = driven(problem)
    assert run.outcome is Outcome.REACHED
    assert run.verified_rate == 1.0
    for one, (_, goal) in zip(run.runs, ends, strict=True):
        assert np.linalg.norm(one.log.positions_m[-1] - goal) <= problem.constraints.goal_radius_m
    # Sampling misses the closest moment by less than this.
    assert SEPARATION_M - 1e-3 <= least_m(tracks) <= run.metrics["min_separation_m"] + 0.1
    assert run.rungs["give_way"] > 0
    walls = shapely.union_all(polygons) if polygons else shapely.Point(-99, -99)
    lines = [shapely.LineString(one.log.positions_m) for one in run.runs]
    assert min(line.distance(walls) for line in lines) >= problem.constraints.clearance_m - 1e-6


def test_standing_head_on_ends_though_giving_way_leaves_contact():
    """Contact is in the street's western part only: to wait is verified, to make room is not."""
    problem = couriers(STREET, SCENES["both are in the street"][1], max_steps=80)

    def power_at(places_m):
        inside = (np.abs(places_m[:, 1] - 15.0) < 2.5) & (places_m[:, 0] < 28.0)
        return np.where(inside, GOOD, BAD)

    run = simulate(problem, prepared=prepared_of(problem, power_at))
    assert run.outcome is Outcome.REACHED
    assert run.metrics["min_separation_m"] >= SEPARATION_M
    walls = shapely.union_all(STREET)
    lines = [shapely.LineString(one.log.positions_m) for one in run.runs]
    assert min(line.distance(walls) for line in lines) >= problem.constraints.clearance_m - 1e-6
    # They do give up the bound where that is dearer than the way alone, and say so.
    released = [plan for plans in run.plans for plan in plans]
    assert any(plan.rung is Rung.GIVE_WAY for plan in released)
    assert any("p_min" in reason for plan in released for reason in plan.certificate.reasons)


BLOCKS = tuple(shapely.box(x, y, x + 6, y + 5) for x in (4, 14, 24) for y in (4.0, 12.5, 21.0))


def drawn_couriers(seed, count=5, separation_m=3.0):
    """Couriers between drawn places in the streets between blocks."""
    generator, walls = np.random.default_rng(seed), shapely.union_all(BLOCKS)

    def place(taken):
        while True:
            found = generator.uniform((1.5, 1.5), (38.5, 28.5)).round(1)
            apart = all(np.hypot(*(found - other)) > separation_m + 0.5 for other in taken)
            if walls.distance(shapely.Point(found)) > 0.8 and apart:
                return found

    starts, goals = [], []
    for _ in range(count):
        starts.append(place(starts))
        goals.append(place(goals))
    ends = [(tuple(start), tuple(goal)) for start, goal in zip(starts, goals, strict=True)]
    problem = couriers(BLOCKS, ends)
    return replace(problem, constraints=replace(problem.constraints, separation_m=separation_m))


@pytest.mark.parametrize("seed", [200, 201])
def test_drawn_couriers_arrive(seed):
    problem = drawn_couriers(seed)
    run, tracks = driven(problem)
    assert (run.outcome, run.verified_rate) == (Outcome.REACHED, 1.0)
    assert least_m(tracks) >= problem.constraints.separation_m - 1e-3


def test_without_a_separation_each_drives_as_if_it_were_alone():
    ends = SCENES["four cross"][1][:2]
    both = couriers((), ends)
    both = replace(both, constraints=replace(both.constraints, separation_m=0.0))
    together, tracks = driven(both)
    assert least_m(tracks) < SEPARATION_M / 2
    for number, robot in enumerate(both.robots):
        alone = simulate(replace(both, robots=(robot,)), prepared=prepared_of(both))
        steps = len(alone.run.log.t_s)
        track = together.runs[number].log.positions_m
        assert np.array_equal(track[:steps], alone.run.log.positions_m)
        assert together.runs[number].metrics.goal_time_s == alone.run.metrics.goal_time_s
    assert together.metrics["goal_time_s"] == max(m.metrics.goal_time_s for m in together.runs)


def test_a_run_that_cannot_end_says_who_is_left():
    """A street that one robot never leaves keeps the other one out."""
    problem = couriers(STREET, [((20, 15), (20, 15)), ((4, 15), (36, 15))], max_steps=3)
    run, _ = driven(problem)
    assert run.outcome is Outcome.STEP_LIMIT
    assert run.reason == "courier1 not arrived after 3 steps"


SHUT = (BELOW, shapely.box(6, 13, 8, 17), shapely.box(32, 13, 34, 17))
SWAP = [((12, 15), (28, 15)), ((28, 15), (12, 15))]


def test_robots_that_shut_each_other_in_never_arrive_and_never_come_too_near():
    """No courses exist in a closed street that nobody passes anybody in; with a niche they do."""
    shut = couriers((*SHUT, shapely.box(8, 17, 32, 30)), SWAP, max_steps=18)
    run, tracks = driven(shut)
    assert run.outcome in (Outcome.STALLED, Outcome.STEP_LIMIT)
    assert "courier0" in run.reason and "courier1" in run.reason
    assert least_m(tracks) >= SEPARATION_M - 1e-3
    room = couriers((*SHUT, NICHE[1]), SWAP)
    assert driven(room)[0].outcome is Outcome.REACHED


def test_no_path_names_the_robot():
    """The wall cuts off one goal of two."""
    wall = shapely.box(20, 0, 21, 30)
    problem = couriers((wall,), [((5, 5), (15, 25)), ((5, 25), (35, 25))])
    with pytest.raises(
        planopt.NoPlanError, match=r"courier1: obstacles separate the goal robots\[1\]"
    ):
        simulate(problem, prepared=prepared_of(problem))


@pytest.fixture(scope="module", name="met")
def _met():
    """Two couriers of a library problem that change places, and their run."""
    problem = planopt.load("open_field")
    robot = problem.robots[0]
    ends = (72.0, 45.0), robot.goal_m
    robots = (
        replace(robot, name="there", start_m=ends[0], goal_m=ends[1]),
        replace(robot, name="back", start_m=ends[1], goal_m=ends[0]),
    )
    constraints = replace(problem.constraints, separation_m=SEPARATION_M)
    settings = replace(problem.planner, horizon=4)
    problem = replace(problem, robots=robots, constraints=constraints, planner=settings)
    return problem, planopt.simulate(problem)


def test_solve_and_the_own_loop_give_the_plans_that_a_run_begins_with(met):
    """One step of each, and a second one of the loop."""
    problem, run = met
    solution = planopt.solve(problem)
    assert [plan.robot for plan in solution.plans] == [one.robot for one in run.runs]
    assert solution.verdict.value == "verified"
    planner = planopt.Planner(problem)
    plans = planner.step_all([robot.start_m for robot in problem.robots])
    for plan, other, made in zip(plans, solution.plans, run.plans, strict=True):
        assert np.array_equal(plan.positions_m, other.positions_m)
        assert np.array_equal(plan.positions_m, made[0].positions_m)
    plans = planner.step_all([plan.next_state for plan in plans])
    assert all(plan.certificate.min_separation_m >= SEPARATION_M - 1e-6 for plan in plans)
