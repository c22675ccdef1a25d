"""Robots of a team that count what the others measure, and rounds that never make it worse."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from terms_scene import TRACKING, terms_problem

from planopt import check
from planopt.objectives.information import Information
from planopt.objectives.moments import posterior_moments
from planopt.planning.loop.closed_loop import simulate
from planopt.planning.plan import Verdict
from planopt.planning.solve import solve
from planopt.planning.stepping import TeamMoment
from planopt.planning.team import team_step

MAPPING = {"kind": "mapping", "form": "information"}


def team(*terms, count=3, **planner):
    """Robots of the small problem that start close to each other."""
    problem = terms_problem(*terms, **{"horizon": 4, "max_steps": 4, **planner})
    first = problem.robots[0]
    robots = [
        replace(first, name=f"robot{k}", start_m=(first.start_m[0], first.start_m[1] + 1.2 * k))
        for k in range(count)
    ]
    return replace(problem, robots=tuple(robots))


def team_information(solution):
    """Information of all places of all plans, each measured once, computed as one set."""
    posterior = solution.belief.posterior
    places = np.vstack([plan.positions_m[1:] for plan in solution.plans])
    kept = [
        k
        for k, place in enumerate(places)
        if (np.linalg.norm(places[:k] - place, axis=1) >= 0.5 - 1e-5).all()
        and (np.linalg.norm(posterior.measurements.positions_m - place, axis=1) >= 0.5 - 1e-5).all()
    ]
    return float(Information().value(posterior_moments(posterior, places[kept])))


@pytest.mark.parametrize("seed", [0, 1])
def test_a_joint_team_tells_more_than_a_decoupled_one(seed):
    """Decoupled robots that start together want the same places."""
    joint = solve(team(MAPPING), seed=seed)
    decoupled = solve(team(MAPPING, coordination="decoupled"), seed=seed)
    assert team_information(joint) > 1.02 * team_information(decoupled)
    assert sum(plan.objective for plan in joint.plans) == pytest.approx(
        team_information(joint), rel=1e-6
    )


@pytest.mark.parametrize(
    "terms",
    [
        (MAPPING,),
    ],
)
def test_rounds_never_make_the_team_worse(terms):
    """After each further round the plans are worth at least as much together."""
    worths = []
    for rounds in (1, 2, 3):
        found = solve(team(*terms, rounds=rounds), seed=3)
        assert all(plan.verdict.value == "verified" for plan in found.plans)
        worths.append(_worth_together(found))
    assert worths[1] >= worths[0] - 1e-9 and worths[2] >= worths[1] - 1e-9


def _worth_together(solution):
    """The plans' values, each given those before it, from a team of its own."""
    from planopt.planning.history import BEGINNING
    from planopt.planning.initial_data import team_seeds
    from planopt.planning.team.team_step import build_team
    from planopt.planning.values.context import Pending

    members = build_team(solution.problem, team_seeds(solution.problem, solution.seed))
    total, made = 0.0, []
    for member, plan, aim in zip(members, solution.plans, solution.aims, strict=True):
        given = replace(aim, pending=Pending(tuple(made)))
        total += member.worth(plan, solution.belief, given, BEGINNING)
        made.append(plan.positions_m[1:])
    return total


@pytest.mark.parametrize(
    "terms",
    [
        (MAPPING,),
        ({"kind": "mapping", "form": "two_layer", "variance_threshold_db2": 2.0},),
        ({"kind": "path_loss_learning"},),
        ({**TRACKING, "form": "recourse"},),
    ],
)
def test_joint_runs_are_judged_from_their_files(terms, tmp_path: Path):
    """What each robot was told is saved, or found again, and the objectives with it."""
    problem = team(*terms, count=2)
    solve(problem, seed=2).save(tmp_path / "plan")
    simulate(problem, seed=2).save(tmp_path / "run")
    assert check(tmp_path / "plan").reasons == ()
    assert check(tmp_path / "run").reasons == ()


def test_a_verified_plan_replaces_one_that_is_not():
    """In a further round, whatever the worth of the plan that is not verified."""
    problem = team(MAPPING, count=2)
    plans = solve(problem, seed=2).plans
    bad = replace(plans[0], verdict=Verdict.VIOLATED, objective=plans[0].objective + 1.0)
    moment = TeamMoment(
        [None] * 2,
        [plan.positions_m[0] for plan in plans],
        [None] * 2,
        [SimpleNamespace(steps=0)] * 2,
        [None] * 2,
        [np.zeros((0, 2))] * 2,
    )

    def member(plan):
        return SimpleNamespace(
            problem=problem, plan=lambda *_: (plan, None), worth=lambda made, *_: made.objective
        )

    members = [member(plan) for plan in plans]
    found, _ = team_step._again_in_turn(problem, members, moment, [bad, plans[1]], [None, None])
    assert [plan.verdict for plan in found] == [Verdict.VERIFIED] * 2
