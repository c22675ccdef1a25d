"""Plans, runs and saved runs of problems with two stations."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planopt import ConnectivityRule, NoPlanError, Plan, Problem, Run, Verdict, check, load
from planopt.planning.initial_data import prepare
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import build_scene
from planopt.planning.solve import simulate, solve
from tests.planning.scenes import WALL, bad_disc, belief_of, small_problem
from tests.planning.two_stations import (
    alone,
    alone_in,
    belief_in,
    east_power,
    prepared_in,
    silent,
    swapped,
    swapped_belief,
    two_station_problem,
    west_power,
    with_station,
)

POWERS = (west_power, east_power)


def planned(problem: Problem, belief) -> Plan:
    planner = ReachPlanner(problem, build_scene(problem))
    return planner.plan(belief, np.asarray(problem.robots[0].start_m))


@pytest.mark.parametrize("planner", ["lattice", "nlp", "scp"])
def test_neither_station_alone_leads_to_the_goal_and_both_do(planner: str) -> None:
    """It takes 15 steps at full speed, some more on a lattice."""
    problem = two_station_problem(horizon=20, planner=planner)
    belief = belief_in(problem, POWERS)
    plan = planned(problem, belief)
    assert plan.verdict is Verdict.VERIFIED
    assert plan.certificate.relaxed_steps == ()
    assert np.linalg.norm(plan.positions_m[-1] - problem.goal_m) <= 1.0
    for station in (0, 1):
        left = planned(alone(problem, station), alone_in(belief, station))
        arrived = np.linalg.norm(left.positions_m[-1] - problem.goal_m) <= 1.0
        assert not arrived or len(left.certificate.relaxed_steps) > 0


@pytest.mark.parametrize("planner", ["lattice", "nlp", "scp"])
def test_a_silent_station_changes_nothing(planner: str) -> None:
    """Round a hole in the coverage of the first."""
    one = small_problem(WALL, horizon=8, planner=planner)
    power = bad_disc(14.0, 15.0, 4.0)
    plan = planned(one, belief_of(one, power))
    both = with_station(one)
    other = planned(both, belief_in(both, (power, silent)))
    assert other.verdict is plan.verdict is Verdict.VERIFIED
    assert other.positions_m == pytest.approx(plan.positions_m, abs=2e-3)
    assert other.objective == pytest.approx(plan.objective, rel=1e-5)
    assert other.connectivity == pytest.approx(plan.connectivity, abs=1e-3)


@pytest.mark.parametrize("planner", ["lattice", "nlp", "scp"])
def test_the_order_of_stations_does_not_matter(planner: str) -> None:
    problem = two_station_problem(horizon=10, planner=planner)
    belief = belief_in(problem, POWERS)
    plan = planned(problem, belief)
    other = planned(swapped(problem), swapped_belief(belief))
    assert other.verdict is plan.verdict
    assert other.positions_m == pytest.approx(plan.positions_m, abs=2e-3)
    assert other.connectivity == pytest.approx(plan.connectivity, abs=1e-3)


@pytest.mark.parametrize("slack_max_db", [None, 3.0])
def test_the_second_station_helps_where_both_are_weak(slack_max_db: float | None) -> None:
    """Two stations that each connect with 0.7 connect with 0.91."""

    def weak(places: np.ndarray) -> np.ndarray:
        return np.full(len(places), -79.87)

    one = small_problem(horizon=3)
    rule = replace(one.constraints.rule, slack_max_db=slack_max_db)
    one = replace(one, constraints=replace(one.constraints, rule=rule))
    both = with_station(one)
    chance = planned(one, belief_of(one, weak)).connectivity
    plan = planned(both, belief_in(both, (weak, lambda places: weak(places) + 5.0)))
    away = np.abs(plan.positions_m - planned(one, belief_of(one, weak)).positions_m).max()
    if away < 1e-9:
        assert plan.connectivity == pytest.approx(1.0 - (1.0 - chance) ** 2, abs=1e-9)
    assert plan.connectivity[1:].min() > chance[1:].max()


@pytest.fixture(scope="module")
def driven() -> Iterator[Run]:
    problem = two_station_problem(horizon=4)
    yield simulate(problem, seed=1, prepared=prepared_in(problem, POWERS))


def test_a_run_is_handed_over(driven: Run) -> None:
    """From one station to the next, connected all the way."""
    assert driven.run.outcome.value == "reached"
    assert driven.run.verified_rate == 1.0
    assert driven.run.log.connected.all()


@pytest.fixture(scope="module")
def courier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A saved run of the library's problem, cut short."""
    problem = load("two_station_courier")
    problem = replace(problem, planner=replace(problem.planner, max_steps=6, horizon=4))
    folder = tmp_path_factory.mktemp("courier")
    simulate(problem, seed=2).save(folder)
    return folder


def test_a_saved_run_is_judged_again(courier: Path) -> None:
    result = check(courier)
    assert result.reasons == ()


def test_a_seed_draws_each_station_its_own_channel() -> None:
    """The first one's is what it is without the second."""
    problem = load("two_station_courier")
    both, first = prepare(problem, 3), prepare(alone(problem, 0), 3)
    assert np.array_equal(both.truths[0].raster.values, first.truths[0].raster.values)
    known, other = (posterior.measurements for posterior in both.belief.posteriors)
    assert np.array_equal(known.positions_m, other.positions_m)
    assert np.array_equal(known.power_dbm, first.belief.posterior.measurements.power_dbm)
    lone = prepare(alone(problem, 1), 3)
    assert not np.array_equal(lone.truths[0].raster.values, both.truths[1].raster.values)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_library_courier_needs_both_stations(seed: int) -> None:
    """Neither alone gives a verified way that keeps the bound."""
    problem = load("two_station_courier")
    plan = solve(problem, horizon=48, seed=seed).plan
    assert plan.verdict is Verdict.VERIFIED
    assert plan.certificate.relaxed_steps == ()
    assert (
        np.linalg.norm(plan.positions_m[-1] - problem.goal_m) <= problem.constraints.goal_radius_m
    )
    belief = prepare(problem, seed).belief
    for station in (0, 1):
        hard = replace(problem.constraints.rule, slack_max_db=0.0)
        left = alone(problem, station)
        left = replace(left, constraints=replace(left.constraints, rule=hard))
        planner = ReachPlanner(left, build_scene(left))
        with pytest.raises(NoPlanError, match="coverage hole"):
            planner.plan(alone_in(belief, station), np.asarray(left.robots[0].start_m))


RULES = {
    "average": (0.9, {"connectivity": "average"}),
    "joint": (0.8, {"connectivity": "joint"}),
    "outage": (0.9, {"connectivity": "outage", "outage_max_m": 4.0}),
    "data": (
        0.0,
        {"connectivity": "data", "data_mbit": 5.5, "deadline_s": 6.0, "rate_mbit_s": 1.0},
    ),
    "slack": (0.9, {"connectivity": "each_step", "slack_max_db": 2.0}),
}


@pytest.mark.parametrize("name", RULES)
def test_plans_keep_other_rules_where_one_station_gives_way_to_the_other(name: str) -> None:
    """From the middle of the rectangle, where both are heard, to where only one is."""
    p_min, rule = RULES[name]
    base = two_station_problem(horizon=6, start_m=(18.0, 15.0))
    constraints = replace(base.constraints, p_min=p_min, rule=ConnectivityRule(**rule))
    problem = replace(base, constraints=constraints)
    plan = planned(problem, belief_in(problem, POWERS))
    assert plan.verdict is Verdict.VERIFIED
    assert plan.positions_m[-1, 0] > 26.0
