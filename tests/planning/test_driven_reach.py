"""Robots with dynamics on the way to a goal, and under every rule of connectivity."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from motion_scene import DOUBLE, WHEELS, driven_problem, with_dynamics
from rules_scene import RULES, ruled_problem
from scenes import WALL, bad_band, belief_of, good_everywhere, prepared_of, small_problem
from terms_scene import TRACKING

from planopt import Obstacle, Problem, Verdict, check, explain
from planopt.channel import Prediction
from planopt.extend import Dynamics
from planopt.planning.loop.log import Outcome
from planopt.planning.plan import Pivot, shifted_drive
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import build_scene
from planopt.planning.solve import simulate, solve
from planopt.planning.values.objective_value import ReachCost, resting_places_m
from planopt.problems import DoubleIntegrator, SingleIntegrator, Unicycle
from planopt.robots.dynamics import rolled_out

BOAT = DoubleIntegrator(2.0, 0.5)
CART = Unicycle(2.0, 0.6)
BACK = (np.pi,)
"""Heading of a cart that turns its back on the goal."""


def reach(*polygons: shapely.Polygon, dynamics: Dynamics, rest=(), **settings) -> Problem:
    """The small problem for a robot with these dynamics; without effort, so that it is quick."""
    asked = {"effort_weight_s2_m2": 0.0, "cost_to_go": "geodesic"} | settings
    return with_dynamics(small_problem(*polygons, **asked), dynamics, *rest)


def driven(problem: Problem, power_at=good_everywhere):
    return simulate(problem, prepared=prepared_of(problem, power_at))


def bang_bang_s(distance_m: float, dynamics: DoubleIntegrator) -> float:
    """Least time from rest to rest along a line: accelerate, cruise, brake."""
    speed, most = dynamics.speed_max_m_s, dynamics.acceleration_max_m_s2
    if distance_m <= speed**2 / most:
        return 2.0 * np.sqrt(distance_m / most)
    return distance_m / speed + speed / most


def swept_distance_m(problem: Problem, simulation) -> float:
    """Least distance of a run's dense samples to the obstacles, by GEOS alone."""
    drive, least = simulation.run.drive, np.inf
    for state, control in zip(drive.states[:-1], drive.inputs, strict=True):
        for part in np.linspace(0.0, problem.planner.step_s, 21):
            place = shapely.Point(*drive.dynamics.step(tuple(state), tuple(control), part)[:2])
            least = min([least, *(place.distance(o.polygon) for o in problem.workspace.obstacles)])
    return least


@pytest.mark.parametrize("horizon", [1, 10])
@pytest.mark.parametrize("acceleration", [0.3, 1.0])
def test_open_line_is_driven_in_about_the_least_time(horizon: int, acceleration: float) -> None:
    """Not sooner than bang-bang control comes to rest in the goal's disc, and two steps later."""
    dynamics = DoubleIntegrator(2.0, acceleration)
    problem = reach(dynamics=dynamics, horizon=horizon)
    simulation = driven(problem)
    least = bang_bang_s(30.0 - problem.constraints.goal_radius_m, dynamics)
    assert simulation.run.outcome is Outcome.REACHED
    assert simulation.run.verified_rate == 1.0
    assert least <= simulation.run.metrics.goal_time_s <= least + 2.0
    assert np.hypot(*simulation.run.drive.states[-1, 2:]) <= 1e-9


def test_a_goal_out_of_contact_is_not_put_off() -> None:
    """With the goal within the horizon, a metre beyond the plan costs as much as a driven one."""
    problem = reach(
        dynamics=DoubleIntegrator(2.5, 0.4),
        rest=(1.0, -0.3),
        start_m=(31.8, 16.0),
        effort_weight_s2_m2=0.1,
        cost_to_go="connected",
        step_s=2.0,
    )
    simulation = driven(problem, bad_band(20.0, 40.0))
    assert simulation.run.outcome is Outcome.REACHED
    assert simulation.run.metrics.goal_time_s <= 16.0


@pytest.mark.parametrize("horizon", [1, 10])
@pytest.mark.parametrize(("dynamics", "rest"), [(BOAT, ()), (CART, BACK)])
def test_goal_behind_a_wall_is_reached(dynamics: Dynamics, rest, horizon: int) -> None:
    """Every step verified, the way clear by samples, and the robot at rest at the goal."""
    problem = reach(WALL, dynamics=dynamics, rest=rest, horizon=horizon)
    simulation = driven(problem)
    assert simulation.run.outcome is Outcome.REACHED, simulation.run.reason
    assert simulation.run.verified_rate == 1.0
    assert swept_distance_m(problem, simulation) >= problem.constraints.clearance_m - 1e-6
    end = simulation.run.drive.states[-1]
    assert np.hypot(end[0] - 35.0, end[1] - 15.0) <= problem.constraints.goal_radius_m


def test_cart_turns_before_it_drives() -> None:
    """With its back to the goal and one step to look ahead, distance alone says: stay."""
    problem = reach(dynamics=CART, rest=BACK, horizon=1)
    states = driven(problem).run.drive.states
    turning = int(np.argmax(np.abs(states[:, 2] - np.pi) > np.pi / 3.0))
    assert np.hypot(*(states[:turning, :2] - states[0, :2]).T).max() <= 2.0


def test_robot_can_always_stop() -> None:
    """The rest of every released plan, then braking, is clear: on any map of the channel."""
    problem = reach(WALL, dynamics=BOAT, horizon=5)
    for plan in driven(problem).plans[0][:12]:
        drive = shifted_drive(problem, plan)
        index = build_scene(problem).index
        ways = drive.dynamics.curves(drive.states[:-1], drive.inputs, problem.planner.step_s)
        ways.append(drive.dynamics.stop_curve(drive.states[-1], problem.planner.step_s))
        clear = min(way.clearance_m(index) for way in ways)
        assert clear >= problem.constraints.clearance_m - 1e-6


@pytest.mark.parametrize(("dynamics", "rest"), [(BOAT, (0.5, 0.0)), (CART, (0.4,))])
def test_mirrored_scene_gives_the_mirrored_plan(dynamics: Dynamics, rest) -> None:
    """Upside down, with what the robot starts with."""
    block = shapely.box(14.0, 8.0, 20.0, 19.0)
    problem = reach(block, dynamics=dynamics, rest=rest, horizon=6)
    turned = Obstacle("block", shapely.box(14.0, 11.0, 20.0, 22.0))
    robot = replace(problem.robots[0], start_rest=(rest[0], 0.0) if len(rest) == 2 else (-rest[0],))
    workspace = replace(problem.workspace, obstacles=(turned,))
    mirrored = replace(problem, workspace=workspace, robots=(robot,))
    one, other = (
        ReachPlanner(p, build_scene(p)).plan(belief_of(p), p.robots[0].start_state)
        for p in (problem, mirrored)
    )
    assert one.verdict is other.verdict is Verdict.VERIFIED
    assert other.objective == pytest.approx(one.objective, rel=1e-3)
    assert 30.0 - other.positions_m[:, 1] == pytest.approx(one.positions_m[:, 1], abs=0.05)


def test_costs_count_from_where_it_would_stand() -> None:
    """Steps, effort, and metres to, and from, the resting place, by hand."""
    problem = reach(dynamics=BOAT, horizon=2, effort_weight_s2_m2=0.1)
    plan = ReachPlanner(problem, build_scene(problem)).plan(
        belief_of(problem), problem.robots[0].start_state
    )
    lengths = np.linalg.norm(np.diff(plan.positions_m, axis=0), axis=1)
    velocity = plan.drive.states[-1, 2:]
    resting = plan.positions_m[-1] + velocity * np.hypot(*velocity) / (2.0 * 0.5)
    ahead = np.linalg.norm(resting - plan.pivot.position_m) + plan.pivot.cost_m
    rate = (1.0 + 0.1 * 2.0**2) / 2.0
    expected = 2.0 + 0.1 * (lengths**2).sum() + rate * ahead
    assert plan.objective == pytest.approx(expected, abs=1e-3)
    problem = reach(dynamics=BOAT, horizon=3)
    rule = problem.stations[0].threshold_dbm
    drive = rolled_out(BOAT, (5.0, 15.0, 1.0, 0.0), np.full((3, 2), (0.3, 0.1)), 1.0)
    goal = Pivot(np.asarray(problem.goal_m), 0.0, 6.0)

    def even(places_m: np.ndarray) -> Prediction:
        return Prediction(np.full(len(places_m), rule), np.full(len(places_m), 3.0))

    cost = ReachCost(problem, drive.positions_m[0], even, ahead=lambda _: goal)
    places = np.vstack([drive.positions_m, resting_places_m(drive)[-1], goal.position_m])
    metres = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    left = np.linalg.norm(places[-1] - places[-2])
    expected = 3.0 + 0.5 * (left + 10.0 * 0.5 * metres)
    assert cost(drive.positions_m[1:], drive) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("low_m", "high_m", "horizon"), [(12.0, 20.0, 8), (10.0, 26.0, 12)])
def test_hole_is_crossed_without_hovering(low_m: float, high_m: float, horizon: int) -> None:
    """What a drive that crosses is worth is told by the search's cost-to-go where it comes to."""
    problem = reach(dynamics=BOAT, cost_to_go="connected", horizon=horizon)
    simulation = driven(problem, bad_band(low_m, high_m))
    assert simulation.run.outcome is Outcome.REACHED, simulation.run.reason
    assert "direct" not in simulation.run.rungs
    assert simulation.run.metrics.goal_time_s <= 1.5 * bang_bang_s(30.0, BOAT)


@pytest.mark.parametrize(("start_x_m", "horizon"), [(29.0, 10), (32.0, 6)])
def test_standing_in_a_hole_it_goes_straight_to_the_goal(start_x_m: float, horizon: int) -> None:
    """What is followed would swing out past the goal: waiting must not look cheaper than that."""
    slow = DoubleIntegrator(3.0, 0.15)
    settings = {"cost_to_go": "connected", "horizon": horizon, "start_m": (start_x_m, 15.0)}
    problem = reach(dynamics=slow, **settings)
    problem = replace(problem, planner=replace(problem.planner, step_s=4.0))
    simulation = driven(problem, bad_band(24.0, 40.0, 40.0))
    least_s = bang_bang_s(35.0 - start_x_m, slow)
    assert simulation.run.metrics.goal_time_s <= least_s + 2 * problem.planner.step_s


SEED = 3


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
@pytest.mark.parametrize("form", RULES)
def test_plan_is_judged_under_the_rule(dynamics, form: str) -> None:
    """With a little slack each is kept; a plan of the solver is a KKT point."""
    problem = with_dynamics(ruled_problem(form, slack_max_db=6.0), dynamics)
    plan = solve(problem, seed=SEED).plans[0]
    assert plan.verdict is Verdict.VERIFIED
    assert plan.certificate.rule is not None
    assert plan.certificate.rule.connectivity == form
    if plan.certificate.kkt_residual is not None:
        assert plan.certificate.kkt_residual < 1e-2


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
@pytest.mark.parametrize("horizon", [1, 3])
def test_missed_steps_are_excused_by_where_it_can_be(dynamics, horizon: int, tmp_path) -> None:
    """Where nothing within reach keeps the bound; a robot that turns at will has more in reach."""
    problem = driven_problem(dynamics, TRACKING, p_min=0.9, horizon=horizon, max_steps=4)
    robot = replace(problem.robots[0], start_m=(37.0, 37.0))
    problem = replace(problem, robots=(robot,))
    plan = solve(problem, seed=SEED).plans[0]
    certificate = plan.certificate
    assert certificate.relaxed_steps
    free = replace(problem, robots=(replace(robot, dynamics=SingleIntegrator(), start_rest=()),))
    wide = solve(free, seed=SEED).plans[0].certificate
    assert wide.relaxed_steps == certificate.relaxed_steps
    assert np.all(np.array(certificate.best_margin_db) <= np.array(wide.best_margin_db) + 0.05)
    assert certificate.best_margin_db[0] < wide.best_margin_db[0]
    run = simulate(problem, seed=SEED)
    run.save(tmp_path)
    assert not [text for text in check(tmp_path).reasons if "is met at none of" not in text]


@pytest.mark.parametrize("dynamics", [DOUBLE, WHEELS])
@pytest.mark.parametrize("uncertain", ["path_loss", "all"])
def test_what_would_help_is_measured_where_it_can_be(dynamics, uncertain: str) -> None:
    """The shortfall is what the verifier misses, and both proposals are verified."""
    problem = driven_problem(dynamics, TRACKING, p_min=0.9, horizon=1)
    robot = replace(problem.robots[0], start_m=(37.0, 37.0))
    rule = replace(problem.constraints.rule, parameter_uncertainty=uncertain)
    constraints = replace(problem.constraints, rule=rule)
    solution = solve(replace(problem, robots=(robot,), constraints=constraints), seed=SEED)
    certificate = solution.plans[0].certificate
    found = {one.constraint: one for one in explain(solution)}
    for key in ("constraints.p_min", "stations[0].threshold_dbm"):
        assert found[key].shortfall == pytest.approx(-certificate.best_margin_db[0], abs=1e-9)
        assert found[key].verified
