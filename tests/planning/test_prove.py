"""Proven bounds of plans: their keys, their proof again from files, and what they never claim."""

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import shapely

import planopt
from planopt import Problem, Solution
from planopt.planning import prove

SECONDS = 6.0


def field(**changes: object) -> Problem:
    """A field of 40 m with a wall, a station and measurements at random positions."""
    parts = {
        "robots": planopt.Robot(start_m=(5.0, 5.0), goal_m=(35.0, 6.0), speed_max_m_s=2.0),
        "stations": planopt.BaseStation(
            position_m=(8.0, 25.0), transmit_power_dbm=10.0, threshold_dbm=-52.0
        ),
        "workspace": planopt.Workspace(
            (0.0, 0.0, 40.0, 30.0), [planopt.Obstacle("wall", shapely.box(18, 0, 21, 20))]
        ),
        "constraints": planopt.Constraints(p_min=0.7, clearance_m=0.5, goal_radius_m=0.5),
        "planner": planopt.PlannerSettings(step_s=1.0, horizon=5),
    }
    return Problem(**{**parts, **changes})


def readings(seed: int = 0, count: int = 40) -> planopt.Measurements:
    """Powers at random positions: path loss, and shadowing of 4 dB."""
    generator = np.random.default_rng(seed)
    positions = generator.uniform((0.0, 0.0), (40.0, 30.0), (count, 2))
    power = 10.0 - 25.0 * np.log10(np.hypot(*(positions - (8.0, 25.0)).T) + 1.0)
    return planopt.Measurements(positions, power - 20.0 + generator.normal(0.0, 4.0, count))


@pytest.fixture(scope="module")
def solution() -> Solution:
    """The open field, proven in a few seconds."""
    return planopt.solve(planopt.load("open_field"), prove_s=SECONDS)


def saved(solution: Solution, folder: Path) -> dict[str, object]:
    """Save a solution, and return its JSON object."""
    solution.save(folder)
    return json.loads((folder / "plan.json").read_text())


def test_plan_and_bound_are_close(solution: Solution) -> None:
    """The bound is below the cost, and ``solve`` smooths the route but keeps the steps."""
    problem = planopt.load("open_field")
    bound, plain = solution.plan.bound, planopt.solve(problem).plan
    first = planopt.Planner(problem).step(problem.robots[0].start_m)
    assert plain.bound is None and bound is not None and bound.value is not None
    assert bound.value <= bound.cost <= plain.objective <= 0.99 * first.objective
    assert np.array_equal(plain.positions_m, first.positions_m)
    assert bound.gap == pytest.approx(1.0 - bound.value / bound.cost) and bound.gap <= 0.1
    assert solution.plan.objective == pytest.approx(bound.cost, rel=2e-3)


def test_the_bound_is_saved_and_proven_again(solution: Solution, tmp_path: Path) -> None:
    """The keys of robot and answer agree; ``check`` accepts them without the solver."""
    data, bound = saved(solution, tmp_path), solution.bound
    assert bound is not None
    [robot] = data["robots"]
    for key in ("bound", "gap", "bound_method"):
        assert data[key] == robot[key]
    assert data["bound"] == bound.value and data["gap"] == bound.gap
    assert planopt.check(tmp_path).verdict is planopt.Verdict.VERIFIED
    again = planopt.load_result(tmp_path)
    assert isinstance(again, Solution) and again.bound is not None
    assert again.bound.value == pytest.approx(bound.value, rel=1e-9)


@pytest.mark.parametrize("factor", [1.00001, 1.001, 1.1, 0.5])
def test_a_changed_bound_is_rejected(solution: Solution, tmp_path: Path, factor: float) -> None:
    """A bound that its certificate does not prove is an objection."""
    data = saved(solution, tmp_path)
    data["bound"] *= factor
    data["robots"][0]["bound"] *= factor
    (tmp_path / "plan.json").write_text(json.dumps(data))
    found = planopt.check(tmp_path)
    assert found.verdict is planopt.Verdict.VIOLATED
    assert any("bound" in reason for reason in found.reasons)


def test_a_missing_certificate_is_named(solution: Solution, tmp_path: Path) -> None:
    """The check says that the file of the certificate is missing."""
    assert "bound_reason" not in saved(solution, tmp_path)
    (tmp_path / "bound.npz").unlink()
    assert any("bound.npz" in reason for reason in planopt.check(tmp_path).reasons)


def test_the_bound_of_a_boat_holds_for_plan_and_route() -> None:
    """The objective of a robot with inertia omits its braking and may lie below the bound."""
    plan = planopt.solve(planopt.load("harbour_reach"), prove_s=2.0).plan
    bound = plan.bound
    assert bound is not None and bound.value is not None and "inertia" in str(bound.relaxed)
    assert plan.objective < bound.value < bound.cost


@pytest.mark.parametrize(
    ("constraints", "words"),
    [
        ({"parameter_uncertainty": "all"}, "parameter_uncertainty"),
        ({"slack_max_db": 0.0}, None),
        ({"slack_max_db": 3.0}, None),
        ({"connectivity": "joint"}, None),
    ],
)
def test_rules_have_a_bound_or_a_reason(constraints: dict[str, object], words: str | None) -> None:
    """A hard limit is relaxed, and said to be; without a bound there is a reason."""
    rule = planopt.ConnectivityRule(**constraints)
    limits = planopt.Constraints(p_min=0.05, clearance_m=0.5, goal_radius_m=0.5, rule=rule)
    problem = field(constraints=limits)
    plan = planopt.solve(problem, measurements=readings(), prove_s=0.5).plan
    assert plan.bound is not None
    if words is not None:
        assert plan.bound.value is None and plan.bound.gap is None
        assert words in plan.bound.reason
    else:
        assert plan.bound.value is not None and plan.bound.value <= plan.bound.cost
        assert plan.bound.relaxed


def test_objectives_without_a_bound_say_so() -> None:
    """A mapping objective has no bound yet: the value is null, with a reason."""
    solution = planopt.solve(planopt.load("fig5"), prove_s=0.5)
    assert solution.plan.bound is not None and solution.plan.bound.value is None
    assert "the term" in solution.plan.bound.reason == solution.data["bound_reason"]


def test_bounds_of_a_team_add_up() -> None:
    """Each robot has its own bound; the answer has their sum, and names the separation."""
    robots = [
        planopt.Robot(name="a", start_m=(5.0, 5.0), goal_m=(14.0, 25.0), speed_max_m_s=2.0),
        planopt.Robot(name="b", start_m=(30.0, 5.0), goal_m=(30.0, 25.0), speed_max_m_s=2.0),
    ]
    limits = planopt.Constraints(p_min=0.1, clearance_m=0.5, goal_radius_m=0.5, separation_m=1.0)
    solution = planopt.solve(
        field(robots=robots, constraints=limits), measurements=readings(), prove_s=1.0
    )
    bounds = [plan.bound for plan in solution.plans]
    assert solution.bound is not None
    assert solution.bound.value == pytest.approx(sum(bound.value for bound in bounds))
    assert solution.bound.cost == pytest.approx(sum(bound.cost for bound in bounds))
    assert any("separation" in words for words in solution.bound.relaxed)


def test_bounds_of_robots_that_keep_apart_are_saved(tmp_path: Path) -> None:
    """Each bound holds given the others' plans; the team's bound does not, and both are checked."""
    first = planopt.solve(planopt.load("outdoor_track"), horizon=5)
    solution = planopt.solve(planopt.load("outdoor_track"), horizon=5, prove_s=6.0)
    data, bound = saved(solution, tmp_path), solution.bound
    assert bound is not None and bound.value is not None
    for old, plan in zip(first.plans, solution.plans, strict=True):
        own = plan.bound
        assert plan.verdict is planopt.Verdict.VERIFIED and plan.objective >= old.objective - 1e-9
        assert own is not None and own.value is not None and own.alone is not None
        assert plan.objective <= own.value <= own.alone * (1.0 + 1e-9)
        assert "given the other robots" in str(own.method)
    assert bound.value == pytest.approx(sum(robot["bound_alone"] for robot in data["robots"]))
    assert "given" not in str(bound.method) and "separation" in str(bound.relaxed)
    assert planopt.check(tmp_path).verdict is planopt.Verdict.VERIFIED
    data["robots"][2]["bound_alone"] *= 0.9
    data["bound"] -= 0.1 * solution.plans[2].bound.alone
    (tmp_path / "plan.json").write_text(json.dumps(data))
    assert planopt.check(tmp_path).verdict is planopt.Verdict.VIOLATED


def test_the_bound_holds_for_steps_within_the_tolerance() -> None:
    """A straight plan whose steps exceed the longest step by the tolerance is not cheaper."""
    steps, step_m = 40, 0.2
    length = steps * (step_m + 0.99e-5)
    robot = planopt.Robot(start_m=(5.0, 25.0), goal_m=(5.05 + length, 25.0), speed_max_m_s=step_m)
    problem = field(
        robots=robot,
        workspace=planopt.Workspace((0.0, 0.0, 40.0, 30.0)),
        objective=planopt.objectives.ReachObjective(outage_price=0.0, effort_weight_s2_m2=0.0),
        constraints=planopt.Constraints(p_min=1e-6, goal_radius_m=0.05 + 1e-9),
        planner=planopt.PlannerSettings(step_s=1.0, horizon=steps),
    )
    bound = planopt.solve(problem, measurements=readings(), prove_s=0.5).bound
    assert bound is not None and bound.value is not None
    assert 0.999 * steps < bound.value <= steps


@pytest.mark.parametrize(
    ("name", "bounds"), [("gap_two_doors", "route_bounds"), ("fig1", "tube_bounds")]
)
@pytest.mark.parametrize("count", [0, 1])
def test_an_interrupt_ends_the_proof(
    monkeypatch: pytest.MonkeyPatch, name: str, bounds: str, count: int
) -> None:
    """The plan and the bounds found before the interrupt are returned."""
    found = getattr(prove, bounds)

    def interrupted(*given: object) -> Iterator[object]:
        yield from islice(found(*given), count)
        raise KeyboardInterrupt

    monkeypatch.setattr(prove, bounds, interrupted)
    plan = planopt.solve(planopt.load(name), horizon=3, prove_s=1.0).plan
    assert plan.verdict is planopt.Verdict.VERIFIED
    assert (plan.bound is not None) == (count > 0)


@pytest.mark.parametrize("name", ["open_field", "trap_spiral", "inertia_slalom"])
def test_the_route_of_a_slow_plan_is_clear(name: str) -> None:
    """A plan that ends before the lattice's path is continued from its own end."""
    problem = planopt.load(name)
    reach = replace(problem.objective, effort_weight_s2_m2=10.0)
    solution = planopt.solve(replace(problem, objective=reach))
    plan = solution.plan
    whole = shapely.LineString(np.vstack([plan.positions_m[-1:], plan.route_m]))
    walls = shapely.union_all([each.polygon for each in problem.workspace.obstacles])
    assert whole.distance(walls) > problem.constraints.clearance_m - 1e-6


def test_a_proven_plan_takes_a_passage_between_lattice_nodes() -> None:
    """The improved plan takes a gap of 1.2 m, is cheaper, and is close to its bound."""
    walls = [shapely.box(18.0, 0.0, 21.0, 12.3), shapely.box(18.0, 13.5, 21.0, 28.0)]
    obstacles = [planopt.Obstacle(str(number), wall) for number, wall in enumerate(walls)]
    problem = field(workspace=planopt.Workspace((0.0, 0.0, 40.0, 30.0), obstacles))
    plain = planopt.solve(problem, measurements=readings()).plan
    plan = planopt.solve(problem, measurements=readings(), prove_s=2.0).plan
    assert plan.bound is not None and plan.bound.gap is not None
    assert plan.verdict is planopt.Verdict.VERIFIED
    assert plan.bound.cost < plain.objective and plan.bound.gap < 0.1


@pytest.mark.parametrize("away_m", [0.0, 0.2])
def test_a_plan_at_its_goal_has_a_bound(away_m: float) -> None:
    """A start at the goal, or within its radius, has a lower bound of zero."""
    robot = planopt.Robot(start_m=(5.0, 5.0), goal_m=(5.0 + away_m, 5.0), speed_max_m_s=2.0)
    bound = planopt.solve(field(robots=robot), measurements=readings(), prove_s=0.2).plan.bound
    assert bound is not None and bound.value == 0.0 <= bound.cost and not bound.reason


@pytest.mark.parametrize("name", ["open_field", "coverage_plain"])
@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf"), 1e9, "x", 1j])
def test_a_proof_needs_a_time(name: str, seconds: object) -> None:
    """All tasks reject by name times of at most 0, above 1e6 s, and values that are no numbers."""
    with pytest.raises(planopt.InputError, match="prove_s"):
        planopt.solve(planopt.load(name), prove_s=seconds)
