"""A plan within a budget of time, and the last fallbacks."""

from dataclasses import replace
from time import perf_counter, sleep

import numpy as np
import pytest
from scenes import WALL, belief_of, small_problem
from terms_scene import LEARNING, TRACKING, context_of, scorer_of, terms_problem

import planopt.planning.candidates as judge_module
import planopt.planning.proof.verify as steps_module
import planopt.planning.refinement as polish_module
from planopt import InputError, MovingObstacle, Problem, Verdict
from planopt.extend import Rung, Termination
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.proof import rule as predictions
from planopt.planning.proof.rule import SEARCH_ERROR_DB
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.refinement import lacks
from planopt.planning.scene import build_scene
from planopt.planning.solve import solve
from planopt.planning.values.objective_value import rule_rows
from planopt.problems import problem_from_dict, problem_to_dict

NO_TIME = 1e-9


def with_budget(problem: Problem, budget_s: float | None) -> Problem:
    return replace(problem, planner=replace(problem.planner, budget_s=budget_s))


def reach_plan(problem: Problem):
    """Plan to a goal from the start."""
    planner = ReachPlanner(problem, build_scene(problem))
    return planner.plan(belief_of(problem), np.asarray(problem.robots[0].start_m))


def terms_plan(problem: Problem):
    """Plan a sum of terms from the start."""
    situation, belief = context_of(problem)
    scorer, ground = scorer_of(situation, belief)
    return HorizonPlanner(problem, ground).plan(situation, scorer)


REACH = small_problem(WALL, start_m=(17.0, 15.0), horizon=8)
TERMS = terms_problem(TRACKING, LEARNING, p_min=0.5)
ADDITIVE = terms_problem(TRACKING, p_min=0.5)


@pytest.mark.parametrize(("plan", "problem"), [(reach_plan, REACH), (terms_plan, ADDITIVE)])
def test_no_time_to_polish(plan, problem):
    """The plan of the lattice planner, on its rung, with the reason."""
    hurried = plan(with_budget(problem, NO_TIME))
    lattice = plan(replace(problem, planner=replace(problem.planner, name="lattice")))
    assert hurried.verdict is Verdict.VERIFIED
    assert hurried.rung is Rung.LATTICE
    assert hurried.termination is Termination.TIME_LIMIT
    assert hurried.iterations == 0 and hurried.solve_s == 0.0
    np.testing.assert_array_equal(hurried.positions_m, lattice.positions_m)
    assert hurried.objective == lattice.objective


def test_no_time_to_search():
    """Terms that couple places: a verified plan of what there is, no better than a whole search."""
    hurried = terms_plan(with_budget(TERMS, NO_TIME))
    lattice = terms_plan(replace(TERMS, planner=replace(TERMS.planner, name="lattice")))
    assert hurried.verdict is Verdict.VERIFIED
    assert (hurried.rung, hurried.termination) == (Rung.LATTICE, Termination.TIME_LIMIT)
    assert hurried.objective <= lattice.objective


@pytest.mark.parametrize(("plan", "problem"), [(reach_plan, REACH), (terms_plan, TERMS)])
def test_time_enough_changes_nothing(plan, problem):
    """A generous budget gives the plan of none, to the last digit."""
    free, timed = plan(problem), plan(with_budget(problem, 1e5))
    np.testing.assert_array_equal(free.positions_m, timed.positions_m)
    assert (free.rung, free.termination) == (timed.rung, timed.termination)


def test_after_the_deadline_nothing_more_is_judged(monkeypatch):
    """Where nothing is verified every start is tried; without time the first, and stopping."""
    calls: list[None] = []
    verify = judge_module.verify

    def object_to(*arguments):
        calls.append(None)
        return replace(verify(*arguments), verdict=Verdict.VIOLATED)

    monkeypatch.setattr(judge_module, "verify", object_to)
    free, count = terms_plan(TERMS), len(calls)
    hurried = terms_plan(with_budget(TERMS, NO_TIME))
    assert free.verdict is hurried.verdict is Verdict.VIOLATED
    assert len(calls) - count <= 2 < count


def test_candidates_share_the_search_within_reach(monkeypatch):
    """Those that miss the bound at the same steps are judged by one search, with one finding."""
    searched: list[tuple[int, ...]] = []
    search = steps_module.best_margins_by_step

    def counted(*arguments):
        searched.append(tuple(arguments[5].tolist()))
        return search(*arguments)

    monkeypatch.setattr(steps_module, "best_margins_by_step", counted)
    situation, belief = context_of(terms_problem(TRACKING, p_min=0.9999))
    scorer, _ = scorer_of(situation, belief)
    deaf = replace(scorer.problem.stations[0], threshold_dbm=0.0)
    problem = replace(scorer.problem, stations=(deaf,))
    scorer = replace(scorer, context=replace(scorer.context, problem=problem))
    first, second = scorer.standing(5), scorer.standing(5)
    assert first.certificate is not None and second.certificate is not None
    assert len(first.certificate.best_margin_db) == 5
    assert first.certificate.best_margin_db == second.certificate.best_margin_db
    assert searched == [(1, 2, 3, 4, 5)]
    moved = replace(scorer.context, state=scorer.state + 0.5)
    replace(scorer, context=moved).standing(5)
    assert len(searched) == 2


def test_a_polish_that_takes_too_long_ends(monkeypatch):
    """IPOPT's own limit: a slow worth does not hold the plan up."""
    local_value = polish_module.local_value

    def slow(*arguments):
        evaluate = local_value(*arguments)

        def at(path_m):
            sleep(0.05)
            return evaluate(path_m)

        return at

    monkeypatch.setattr(polish_module, "local_value", slow)
    begun = perf_counter()
    # The form of 12 steps ahead is another by default.
    terms = terms_problem({**TRACKING, "form": "additive"}, LEARNING, p_min=0.5, horizon=12)
    problem = with_budget(terms, 0.2)
    plan = terms_plan(problem)
    assert plan.termination is Termination.TIME_LIMIT
    assert plan.verdict is Verdict.VERIFIED
    assert plan.iterations < 20
    assert perf_counter() - begun < 20.0


def test_key_of_the_problem_file():
    """Saved where it is given; a budget of nothing is refused by its key."""
    for budget in (None, 2.5):
        tables = problem_to_dict(with_budget(TERMS, budget))
        assert tables["planner"].get("budget_s") == budget
        assert ("budget_s" in tables["planner"]) == (budget is not None)
        assert problem_from_dict(tables).planner.budget_s == budget
    with pytest.raises(InputError, match=r"planner\.budget_s"):
        problem_from_dict({**tables, "planner": {**tables["planner"], "budget_s": 0.0}})


def test_standing_before_the_first_plan_is_a_stop() -> None:
    """Nothing is reserved but standing, so that there is no last plan to go on with."""
    problem = terms_problem(TRACKING, horizon=3)
    x, y = problem.robots[0].start_m
    # Wider and faster than the robot can flee from.
    steamroller = MovingObstacle("roller", 60.0, (0.0,), ((x + 90.0, y),), (-40.0, 0.0))
    blocked = replace(problem, workspace=replace(problem.workspace, moving=(steamroller,)))
    plan = solve(blocked).plans[0]
    assert plan.verdict is Verdict.VIOLATED
    assert plan.rung is Rung.STOP
    assert np.ptp(plan.positions_m, axis=0).max() == 0.0


@pytest.mark.parametrize("exact", [True, False])
def test_a_margin_within_the_error_of_searches_is_not_relied_on(exact, monkeypatch) -> None:
    """Half of the error to spare is enough where searches are exact, or once it was tried."""
    problem = terms_problem(TRACKING, horizon=4, p_min=0.6)
    situation, _ = context_of(problem)
    path = np.tile(situation.position_m, (4, 1)) + np.arange(1.0, 5.0)[:, None] * (0.5, 0.2)
    rows = rule_rows(situation, path)
    # The threshold is set so that the path has just that to spare.
    least = float(rows.margins_db(situation.power(path)).min())
    rows = replace(rows, threshold_dbm=rows.threshold_dbm + least - 0.5 * SEARCH_ERROR_DB)
    if not exact:
        monkeypatch.setattr(predictions, "SEARCH_EXACT_LIMIT", 0)
    power, held = situation.power(path), np.ones(4, dtype=bool)
    assert lacks(situation, power, rows, held, firmly=True) is not exact
    assert not lacks(situation, power, rows, held)
