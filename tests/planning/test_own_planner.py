"""Planners from outside plug in by name: registered, or by the entry points of a package."""

from dataclasses import replace
from time import perf_counter
from types import SimpleNamespace

import numpy as np
import pytest

from planopt import InputError, Verdict, check, load, load_result, simulate, solve
from planopt.extend import PlannerKind, register_planner, released, unregister_planner
from planopt.planning.candidates import held
from planopt.planning.loop.log import Outcome
from planopt.planning.plan import Rung, Termination
from planopt.planning.planners import LawnmowerPlanner
from planopt.planning.reservations import with_separations
from planopt.problems import problem_to_dict, settings
from planopt.problems.load import with_changes
from planopt.problems.problem import problem_from_tables
from planopt.problems.settings import OWN, planner_kind, planner_names


class Eastward:
    """Drives east with half the speed."""

    def __init__(self, problem, ground, generator) -> None:
        self._step_m = 0.5 * problem.step_length_m

    def plan(self, context, scorer, warm=None):
        begun = perf_counter()
        horizon = context.problem.planner.horizon
        steps = np.arange(1, horizon + 1)[:, None] * np.array([self._step_m, 0.0])
        return released(scorer, held(context, list(context.position_m + steps)), begun)


@pytest.fixture
def eastward(own_parts) -> None:
    register_planner(PlannerKind("eastward", Eastward))


def test_registered_planner_plans(eastward, tmp_path) -> None:
    """Its path is the plan, the verifier judges it, and so does the check from the files."""
    solution = solve(load("outdoor_map"), planner="eastward", horizon=4)
    path_m, step_m = solution.plan.positions_m, solution.problem.step_length_m
    assert path_m[1:] - path_m[:-1] == pytest.approx(np.array([[0.5 * step_m, 0.0]] * 4))
    assert solution.problem.planner.name == "eastward"
    solution.save(tmp_path)
    assert check(tmp_path).verdict is solution.verdict
    tables = problem_to_dict(solution.problem)
    unregister_planner("eastward")
    with pytest.raises(InputError, match="is 'eastward', should be 'auto'"):
        problem_from_tables(tables, folder=tmp_path, file=None)


def test_it_plans_what_it_says_it_plans(eastward) -> None:
    """Without the traits there are no goals and no dynamics."""
    with pytest.raises(InputError, match="cannot plan to a goal"):
        solve(load("open_field"), planner="eastward")
    with pytest.raises(InputError, match="supports only the dynamics"):
        solve(load("harbour_track"), planner="eastward")
    assert "eastward" in planner_names()


def test_entry_points(monkeypatch) -> None:
    """A package gives a kind, or what makes the planner; neither is imported before it is named."""
    points = [
        SimpleNamespace(
            name="mower", load=lambda: PlannerKind("", LawnmowerPlanner, has_dynamics=True)
        ),
        SimpleNamespace(name="east", load=lambda: Eastward),
        SimpleNamespace(name="auto", load=lambda: Eastward),
        SimpleNamespace(name="broken", load=lambda: __import__("no_such_module")),
    ]
    monkeypatch.setattr(settings.PLANNERS, "installed", {one.name: one for one in points})
    monkeypatch.setattr(settings.PLANNERS, "registered", {})
    assert planner_names() == (*OWN, "mower", "east", "broken")
    assert planner_kind("mower") == PlannerKind("mower", LawnmowerPlanner, has_dynamics=True)
    assert planner_kind("east") == PlannerKind("east", Eastward)
    assert planner_kind("auto") is OWN["auto"]
    with pytest.raises(InputError, match="whose package cannot be imported"):
        planner_kind("broken")


@pytest.mark.parametrize("name", ["auto", "", "a b", "x" * 101])
def test_names_that_cannot_be(name: str) -> None:
    """Those of planopt's own, and what is no word."""
    with pytest.raises(InputError, match="cannot be the name of a planner"):
        register_planner(PlannerKind(name, Eastward))


def test_a_planner_that_cannot_be_imported() -> None:
    for make in ("no_such_module:Planner", "planopt.errors:Nothing"):
        with pytest.raises(InputError, match="cannot be imported"):
            PlannerKind("mine", make).maker()
    with pytest.raises(InputError, match="is 'mine'"):
        planner_kind("mine")


def test_own_planners_can_all_be_made() -> None:
    """Each name of planopt's own leads to something that makes a planner."""
    assert all(callable(kind.maker()) for kind in OWN.values())


class Straight:
    """Drives straight to the goal with a share of the largest speed, through walls."""

    share = 0.9

    def __init__(self, problem, ground, generator) -> None:
        self._goal_m = np.array(problem.goal_m)
        self._step_m = self.share * problem.step_length_m

    def plan(self, context, scorer, warm=None):
        """The straight line, which ends at the goal."""
        begun, here = perf_counter(), context.position_m
        away = np.linalg.norm(self._goal_m - here)
        steps = np.arange(1, context.problem.planner.horizon + 1) * self._step_m
        share = np.minimum(steps / max(away, 1e-9), 1.0)[:, None]
        return released(scorer, here + share * (self._goal_m - here), begun)


class TooFast(Straight):
    """Its steps are too long."""

    share = 1.5


@pytest.mark.parametrize(
    ("planner", "reason"), [(Straight, "comes within"), (TooFast, "longer than")]
)
def test_a_planner_to_a_goal(planner, reason: str, tmp_path, own_parts) -> None:
    """Its verified paths are released, others are rejected with the reason; every run arrives."""
    register_planner(PlannerKind("straight", planner, reaches_goals=True))
    problem = load("open_field")
    plan = solve(problem, planner="straight", horizon=8).plan
    assert plan.verdict is Verdict.VERIFIED
    assert reason in plan.rejected
    run = simulate(problem, planner="straight", horizon=8)
    assert run.outcome is Outcome.REACHED
    assert run.verified_rate == 1.0
    assert not run.plans[0][-1].rejected
    for result in (solve(problem, planner="straight", horizon=8), run):
        result.save(tmp_path)
        assert check(tmp_path).verdict is Verdict.VERIFIED
        assert load_result(tmp_path) == result


class Meeting(Eastward):
    """Drives every robot to the middle of the world, and releases plans that are not sound."""

    def plan(self, context, scorer, warm=None):
        begun, problem = perf_counter(), context.problem
        x_min, y_min, x_max, y_max = problem.workspace.bounds_m
        aim = np.array([0.5 * (x_min + x_max), 0.5 * (y_min + y_max)])
        shares = np.linspace(0.0, 1.0, problem.planner.horizon + 1)[1:, None]
        to_aim = aim - context.position_m
        away = np.linalg.norm(to_aim)
        reach = min(1.0, problem.planner.horizon * self._step_m / away)
        path = context.position_m + shares * reach * to_aim
        found = scorer.candidate(held(context, list(path)), Rung.PLAN, Termination.LATTICE_ONLY)
        return scorer.plan_from(scorer.assessed(found), wall_s=perf_counter() - begun)


def test_robots_that_come_too_close_are_not_verified(own_parts, tmp_path) -> None:
    """Neither of a pair, whichever was planned first, as the check from the files finds."""
    register_planner(PlannerKind("meeting", Meeting))
    problem = with_changes(load("team_map"), {"constraints.separation_m": 3.0})
    solution = solve(problem, planner="meeting", horizon=6)
    assert {plan.verdict for plan in solution.plans} == {Verdict.VIOLATED}
    assert all("separation_m" in plan.message for plan in solution.plans)
    unproven = [replace(plan, verdict=Verdict.FEASIBLE_UNVERIFIED) for plan in solution.plans]
    judged = with_separations(solution.problem, 0, unproven)
    assert {plan.verdict for plan in judged} == {Verdict.VIOLATED}
    solution.save(tmp_path)
    assert check(tmp_path).verdict is solution.verdict
