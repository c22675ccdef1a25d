"""Teams that count the others' measurements, and weigh terms by themselves."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from terms_scene import ENERGY, LEARNING, TRACKING, terms_problem

from planopt import InputError, Verdict, check, load
from planopt.objectives.information import Information
from planopt.objectives.moments import posterior_moments
from planopt.planning.loop.log import Outcome
from planopt.planning.solve import simulate, solve
from planopt.planning.stepping import TeamMoment
from planopt.planning.team import team_step
from planopt.problems import problem_from_dict, problem_to_dict
from planopt.problems.load import with_overrides
from planopt.problems.problem import check_problem

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


@pytest.mark.parametrize("terms", [(MAPPING,)])
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
    from planopt.planning.initial_data import team_seeds
    from planopt.planning.plan import BEGINNING
    from planopt.planning.team.team_step import build_team
    from planopt.planning.values.context import Pending

    members = build_team(solution.problem, team_seeds(solution.problem, solution.seed))
    total, made = 0.0, []
    for member, plan, aim in zip(members, solution.plans, solution.aims, strict=True):
        given = replace(aim, pending=Pending(tuple(made)))
        total += member.value(plan, solution.belief, given, BEGINNING)
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
            problem=problem, plan=lambda *_: (plan, None), value=lambda made, *_: made.objective
        )

    members = [member(plan) for plan in plans]
    found, _ = team_step._again_in_turn(problem, members, moment, [bad, plans[1]], [None, None])
    assert [plan.verdict for plan in found] == [Verdict.VERIFIED] * 2


GOAL = {"kind": "goal", "weight": 5.0}


def weighted_team(*terms, weights, **planner):
    """Robots of the small problem, one for each tuple of weights; None is a robot without."""
    problem = terms_problem(*terms, **{"horizon": 3, "max_steps": 3, **planner})
    first = problem.robots[0]
    robots = [
        replace(first, name=f"robot{k}", start_m=(10.0, 15.0 + 3.0 * k), weights=own or ())
        for k, own in enumerate(weights)
    ]
    problem = replace(problem, robots=tuple(robots))
    check_problem(problem)
    return problem


def courier_and_scout(**planner):
    """A robot that goes to its goal, and one that maps the channel until then."""
    tables = problem_to_dict(terms_problem(MAPPING, **{"horizon": 3, "max_steps": 30, **planner}))
    tables["objective"]["terms"].append(GOAL)
    first = tables["robots"][0]
    tables["robots"] = [
        {**first, "name": "courier", "goal_m": [10.0, 24.0], "weights": [0.0, 5.0]},
        {**first, "name": "scout", "start_m": [13.0, 12.0], "weights": [1.0, 0.0]},
    ]
    tables["constraints"]["separation_m"] = 1.0
    return problem_from_dict(tables)


def paths(problem, seed=0):
    """Paths of all robots, of one step."""
    return [plan.positions_m for plan in solve(problem, seed=seed).plans]


@pytest.mark.parametrize("terms", [(LEARNING, ENERGY), (TRACKING, ENERGY), (MAPPING,)])
def test_weights_equal_to_those_of_the_terms_change_nothing(terms):
    """Bit by bit, for some of the robots or for all."""
    weighted = tuple(term.get("weight", 1.0) for term in terms)
    common = paths(weighted_team(*terms, weights=[None, None]))
    for weights in ([weighted, weighted], [None, weighted]):
        for one, other in zip(common, paths(weighted_team(*terms, weights=weights)), strict=True):
            assert np.array_equal(one, other)


@pytest.mark.parametrize("terms", [(LEARNING, ENERGY), (MAPPING, ENERGY)])
def test_a_term_of_weight_zero_is_not_there(terms):
    """A robot alone plans as in the problem that never had the term, and so do two of a team."""
    (found,) = paths(weighted_team(*terms, weights=[(1.0, 0.0)]))
    assert np.array_equal(found, paths(weighted_team(terms[0], weights=[None]))[0])
    moves, stands = paths(weighted_team(*terms, weights=[(1.0, 0.0), (0.0, 3.0)]))
    assert np.array_equal(moves, found)
    assert np.abs(stands - stands[0]).max() < 1e-9 < np.abs(moves - moves[0]).max()


def test_only_robots_whose_terms_count_the_others_are_told_of_them():
    """A robot that only saves energy is told nothing; what it does counts for the mapping one."""
    solution = solve(weighted_team(MAPPING, ENERGY, weights=[(0.0, 1.0), None, (1.0, 0.0)]))
    assert [len(aim.pending.planned_m) for aim in solution.aims] == [0, 1, 2]


def test_a_courier_arrives_while_a_scout_maps(tmp_path):
    """The run ends when the courier has arrived; the saved run is sound, and a changed one not."""
    problem = courier_and_scout()
    run = simulate(problem, seed=1)
    courier, scout = (one.log.positions_m for one in run.runs)
    assert (run.outcome, run.verified_rate) == (Outcome.REACHED, 1.0)
    assert np.linalg.norm(courier[-1] - (10.0, 24.0)) <= problem.constraints.goal_radius_m
    assert np.linalg.norm(np.diff(scout, axis=0), axis=1).sum() > 5.0
    run.save(tmp_path)
    assert check(tmp_path).verdict.value == "verified"
    file = tmp_path / "run.json"
    record = json.loads(file.read_text())
    record["problem_file"]["robots"][1]["weights"] = [2.0, 0.0]
    file.write_text(json.dumps(record))
    assert check(tmp_path).verdict.value != "verified"


def test_weights_are_read_and_saved():
    problem = courier_and_scout()
    assert [robot.weights for robot in problem.robots] == [(0.0, 5.0), (1.0, 0.0)]
    assert problem_from_dict(problem_to_dict(problem)) == problem


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        ((1.0,), r"weights has 1 numbers for 2 objective\.terms"),
        ((0.0, 0.0), r"weights has only zeros"),
        ((-1.0, 1.0), r"robots\[\]\.weights\[0\] is -1\.0"),
        ((float("nan"), 1.0), r"robots\[\]\.weights\[0\] is nan"),
    ],
)
def test_weights_that_say_nothing_are_named(weights, words):
    with pytest.raises(InputError, match=words):
        weighted_team(LEARNING, ENERGY, weights=[weights])


def test_goals_and_weights_go_together():
    """A goal without a term that leads there, a term without its goal, and the task reach."""
    tables = problem_to_dict(courier_and_scout())
    courier, scout = tables["robots"]
    for robots, words in (
        (
            [{**courier, "weights": [1.0, 0.0]}, scout],
            r"goal_m needs a term of kind .goal. with a weight above",
        ),
        ([courier, {**scout, "weights": [1.0, 2.0]}], r"needs robots\[1\]\.goal_m"),
    ):
        with pytest.raises(InputError, match=words):
            problem_from_dict({**tables, "robots": robots})
    reach = {
        **tables,
        "problem": {**tables["problem"], "task": "reach"},
        "robots": [courier],
        "objective": {},
    }
    reach["constraints"]["p_min"] = 0.5
    with pytest.raises(InputError, match=r"has no terms"):
        problem_from_dict(reach)


PROBLEMS = Path(__file__).parents[3] / "benchmarks" / "problems"
STEPS = 20


@pytest.mark.parametrize(
    ("name", "horizon"),
    [
        ("indoor_learn", 5),
        ("outdoor_map", 1),
        (PROBLEMS / "hall_learn.toml", 1),
        (PROBLEMS / "yard_map.toml", 5),
    ],
)
def test_nearly_every_step_measures(name, horizon):
    """At least 95 %, where unmeasured places remain all the time."""
    problem = with_overrides(load(name), horizon=horizon)
    problem = replace(problem, planner=replace(problem.planner, max_steps=STEPS))
    run = simulate(problem, seed=3)
    assert run.runs[0].outcome.value == "completed"
    assert run.metrics["measured_steps"] >= 0.95 * STEPS


def test_the_two_layer_form_reaches_what_it_steers_to():
    """One step ahead it crosses the yard instead of circling a node of the lattice."""
    problem = load(PROBLEMS / "yard_two_layer.toml")
    run = simulate(problem, seed=3)
    places = run.runs[0].log.positions_m
    assert run.metrics["path_m"] > 0.9 * problem.planner.max_steps * problem.step_length_m
    assert (places.max(axis=0) - places.min(axis=0)).min() > 15.0
