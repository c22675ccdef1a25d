"""Excuses of missed steps, certificates of teams, and coverage holes, with their words."""

import json
import re
from dataclasses import asdict, replace

import numpy as np
import pytest
from scenes import bad_band, belief_of, small_problem

import planopt
from planopt import NoPlanError, Verdict
from planopt.planning.certificate import (
    MOST_EXCUSED,
    Certificate,
    excused_in_words,
    excused_steps,
    goal_in_words,
    holes_along,
    holes_in_words,
    worst_of,
    worst_of_robots,
)
from planopt.planning.explain.explain import explain_crossing
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import build_scene

PROOF = Certificate(1.0, 0.5, 0.0, None, "exact")
PRICED = replace(PROOF, relaxed_steps=(1, 3), relaxation_db=(0.5, 2.0), path_cost_m=8.0)
PRICED = replace(PRICED, best_cost_m=7.5)
FAR = replace(PROOF, relaxed_steps=(2,), relaxation_db=(1.25,), best_margin_db=(-0.75,))


def said(proofs: list[Certificate]) -> list[str]:
    return excused_in_words(excused_steps(proofs))


def test_a_plan_tells_of_all_its_steps():
    """By how much each misses the bound, and what the price of it was compared with."""
    first, second = said([PRICED])
    assert first == (
        "step 1 misses p_min by 0.50 dB of power: the route has a priced length of 8.0 m, "
        "and the cheapest route that the verifier found has 7.5 m"
    )
    assert second.startswith("step 3 misses p_min by 2.00 dB of power")
    assert said([FAR]) == [
        "step 2 misses p_min by 1.25 dB of power: the best reachable position misses it by 0.75 dB"
    ]


def test_excuses_of_driven_steps():
    """The first step of each plan; no excuse where a place keeps the bound, or nothing compares."""
    lines = said([PROOF, PRICED, FAR, PRICED])
    assert [line.split(" misses")[0] for line in lines] == ["step 2", "step 4"]
    many = said([PRICED] * (MOST_EXCUSED + 3))
    assert len(many) == MOST_EXCUSED + 1 and many[-1] == "and 3 more steps below p_min"
    assert said([PROOF, FAR]) == []
    kept = replace(FAR, best_margin_db=(0.25,))
    assert said([kept])[0].endswith("nothing excuses it")
    refused = replace(FAR, best_margin_db=(), reasons=("too far",))
    assert said([refused])[0].endswith("nothing excuses it")
    slack = replace(FAR, best_margin_db=())
    assert said([slack])[0].endswith("within constraints.slack_max_db")
    for way_m, best_m in ((np.inf, np.inf), (np.inf, 7.0), (8.0, np.inf)):
        lost = replace(PRICED, path_cost_m=way_m, best_cost_m=best_m)
        assert lost.excess_m is None
        assert said([lost])[0].endswith("nothing excuses it")
        json.dumps([asdict(one) for one in excused_steps([lost])], allow_nan=False)
        worst = worst_of([lost, PRICED])
        assert (worst.path_cost_m, worst.best_cost_m) == (8.0, 7.5)


def test_merged_certificates():
    """The dearest plan and step, and the worst value of every other number."""
    cheap = replace(PRICED, path_cost_m=90.0, best_cost_m=89.9, step_cost_m=6.0, step_excess_m=5.0)
    worst = worst_of([PROOF, PRICED, cheap])
    assert (worst.path_cost_m, worst.best_cost_m) == (8.0, 7.5)
    assert (worst.step_cost_m, worst.step_excess_m) == (6.0, 5.0)
    worst = worst_of([PROOF, FAR])
    assert (worst.path_cost_m, worst.step_cost_m, worst.step_excess_m) == (None, None, None)
    merged = worst_of_robots({"a": cheap, "b": PRICED})
    assert (merged.path_cost_m, merged.best_cost_m, merged.step_excess_m) == (8.0, 7.5, 5.0)
    worst = worst_of_robots({"a": GOOD, "b": BAD, "c": WORSE})
    assert (worst.min_clearance_m, worst.min_connectivity) == (1.0, 0.4)
    assert (worst.dynamics_defect, worst.kkt_residual) == (1e-9, 1e-7)
    assert worst.posterior == "neighbours:512"
    assert worst.relaxed_steps == (1, 2, 3)
    assert worst.relaxation_db == (2.0, 1.0, 5.0)
    assert worst.best_margin_db == (-1.0, -0.5, -4.0)
    assert worst.reasons == ("b: too near",)


GOOD = Certificate(3.0, 0.95, 0.0, None, "exact")
BAD = Certificate(
    1.0, 0.5, 1e-9, 1e-7, "neighbours:512", (1, 3), (2.0, 4.0), (-1.0, -3.0), reasons=("too near",)
)
WORSE = Certificate(2.0, 0.4, 0.0, 1e-8, "exact", (2, 3), (1.0, 5.0), (-0.5, -4.0))


PROBLEM = small_problem()


def line(*x_m: float) -> np.ndarray:
    return np.array([(x, 15.0) for x in x_m])


def test_lengths_by_hand():
    """Steps within count whole, steps in and out by half; a hole may be at either end."""
    places = line(0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 11.0)
    chance = np.array([0.2, 0.95, 0.5, 0.4, 0.95, 0.95, 0.1])
    first, middle, last = holes_along(places, chance, chance < 0.9)
    assert (first.length_m, middle.length_m, last.length_m) == (1.0, 4.0, 0.5)
    assert middle.from_m == (4.0, 15.0) and middle.to_m == (6.0, 15.0)
    assert middle.least_connectivity == 0.4
    assert [hole.to_end for hole in (first, middle, last)] == [False, False, True]


def test_a_plan_names_the_hole_ahead_of_it():
    """Beyond its horizon as well, to the goal where that is in it."""
    for low, high, at_goal in ((18.0, 24.0, False), (30.0, 41.0, True)):
        power = bad_band(low, high)
        plan = ReachPlanner(PROBLEM, build_scene(PROBLEM)).plan(
            belief_of(PROBLEM, power), np.array(PROBLEM.robots[0].start_m)
        )
        assert plan.certificate.relaxed_steps == ()
        [hole] = plan.holes
        assert low - 2.0 <= hole.from_m[0] <= low + 3.0
        assert hole.to_end == at_goal == bool(goal_in_words(PROBLEM, plan.holes))
        assert np.allclose(plan.route_m[-1], PROBLEM.goal_m)
        told = " ".join(holes_in_words(PROBLEM, plan.holes))
        assert f"{hole.length_m:.0f} m" in told


@pytest.mark.parametrize(("high_m", "in_goal"), [(24.0, False), (41.0, True)])
def test_a_hard_bound_says_what_is_crossed(high_m: float, in_goal: bool):
    """Every hole of the cheapest path, and a goal in one."""
    hard = replace(PROBLEM.constraints.rule, slack_max_db=0.0)
    problem = replace(PROBLEM, constraints=replace(PROBLEM.constraints, rule=hard))
    with pytest.raises(NoPlanError) as told:
        ReachPlanner(problem, build_scene(problem)).plan(
            belief_of(problem, bad_band(18.0, high_m)), np.array(problem.robots[0].start_m)
        )
    words = str(told.value)
    assert re.search(
        r"the cheapest crosses a coverage hole of \d+ m that begins at \(1[6-9]", words
    )
    assert ("P(connected) at the goal" in words) == in_goal


@pytest.mark.parametrize(
    ("open_above_m", "goal_m"), [(70.0, (35.0, 15.0)), (np.inf, (35.0, 15.0)), (70.0, (20.0, 15.0))]
)
def test_why_a_hole_is_crossed(open_above_m: float, goal_m: tuple[float, float]):
    """Its price, and the length of the way round where there is one; a goal in it is named."""
    problem = small_problem(bounds_m=(0.0, 0.0, 40.0, 80.0), goal_m=goal_m)
    belief = belief_of(problem, bad_band(18.0, 21.0, open_above_m))
    plan = ReachPlanner(problem, build_scene(problem)).plan(belief, np.array([5.0, 15.0]))
    found = explain_crossing(problem, belief.posteriors, plan)
    assert found is not None and found.holes == plan.holes
    length_m = goal_m[0] - 5.0
    # A metre costs eleven at most.
    below_m = sum(hole.length_m for hole in plan.holes)
    assert length_m < found.cost_m <= length_m + 10.0 * (below_m + 2.0)
    in_goal = goal_m[0] == 20.0
    assert found.at_goal == in_goal == ("also at the goal itself" in str(found))
    if np.isinf(open_above_m) or in_goal:
        assert 0.0 < found.outside_m < below_m + 2.0
        assert "No lattice route stays connected throughout" in str(found)
    else:
        round_m = 2.0 * np.hypot(15.0, 55.0)
        assert found.outside_m == 0.0 and round_m < found.kept_m < 1.1 * round_m
        assert f"route that stays connected is {found.kept_m:.0f} m long" in str(found)
    assert found.kept_m + 10.0 * found.outside_m >= found.cost_m - 4.0


def test_plans_say_what_they_cross_and_why(tmp_path):
    """The file has the numbers of the explanation, and none of them can be edited or left out."""
    problem = planopt.load("open_field")
    strict = replace(problem, constraints=replace(problem.constraints, p_min=0.999))
    solution = planopt.solve(strict, horizon=2)
    (told,) = planopt.explain(solution)
    replace(solution, explanation=(told,)).save(tmp_path)
    file = tmp_path / "plan.json"
    data = json.loads(file.read_text())
    (crossing,) = data["crossings"]
    for key in ("robot", "outage_price", "cost_m", "kept_m", "outside_m", "at_goal"):
        assert crossing[key] == getattr(told, key)
    wrong = {"robot": "nobody", "outage_price": 11.0, "at_goal": True, "outside_m": 1e6}
    for key, value in wrong.items():
        file.write_text(json.dumps({**data, "crossings": [{**crossing, key: value}]}))
        assert planopt.check(tmp_path).verdict is Verdict.VIOLATED, key
    file.write_text(json.dumps({**data, "crossings": [crossing, crossing]}))
    assert planopt.check(tmp_path).verdict is Verdict.VIOLATED
    file.write_text(json.dumps({key: data[key] for key in data if key != "crossings"}))
    assert planopt.check(tmp_path).verdict is Verdict.VIOLATED


def test_of_many_holes_the_longest_are_told():
    below = np.arange(40) % 4 == 1
    holes = holes_along(line(*range(40)), np.where(below, 0.1, 0.95), below)
    longest = replace(holes[3], length_m=9.0)
    told = holes_in_words(PROBLEM, (*holes[:3], longest, *holes[4:]))
    assert len(told) == 6 and "9 m" in told[3]
    assert told[4].endswith(f"{len(holes) - 4} shorter holes")
