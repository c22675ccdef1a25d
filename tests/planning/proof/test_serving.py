"""The verifier with several stations: what it computes, and what it must reject."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import verified
from scipy.special import ndtr

from planopt import ConnectivityRule, Problem, Verdict
from planopt.channel import Belief
from planopt.channel.kriging import connection_probability
from planopt.planning.certificate import Certificate
from planopt.world import index_obstacles
from tests.planning.scenes import bad_everywhere, straight_path
from tests.planning.two_stations import (
    alone,
    alone_in,
    belief_in,
    east_power,
    known_in,
    swapped,
    swapped_belief,
    two_station_problem,
    west_power,
)

POWERS = (west_power, east_power)


def assessed(problem: Problem, belief, path: np.ndarray) -> tuple[Certificate, Verdict]:
    under = known_in(problem, belief)
    index = index_obstacles(problem.workspace)
    found = verified(problem, index, belief.posterior, path[0], path, **under)
    return found.certificate, found.verdict


def across(**changes: object) -> tuple[Problem, np.ndarray]:
    """A path through the places that only one station each serves."""
    problem = two_station_problem(horizon=14, **changes)
    return problem, straight_path(problem)


def test_a_path_that_is_handed_over_is_verified() -> None:
    problem, path = across()
    certificate, verdict = assessed(problem, belief_in(problem, POWERS), path)
    assert verdict is Verdict.VERIFIED
    assert certificate.relaxed_steps == ()
    assert certificate.posterior == "exact"


def hard(problem: Problem) -> Problem:
    return with_rule(problem, 0.9, connectivity="each_step", slack_max_db=0.0)


@pytest.mark.parametrize("station", [0, 1])
def test_it_is_not_without_either_station(station: int) -> None:
    """Whether it is taken out of the problem or falls silent."""
    base, path = across()
    belief = belief_in(base, POWERS)
    dead = belief_in(
        base, (bad_everywhere, east_power) if station else (west_power, bad_everywhere)
    )
    left = alone_in(belief, station)
    assert assessed(hard(base), belief, path)[1] is Verdict.VERIFIED
    assert assessed(hard(alone(base, station)), left, path)[1] is Verdict.VIOLATED
    assert assessed(hard(base), dead, path)[1] is Verdict.VIOLATED
    certificate, _ = assessed(alone(base, station), left, path)
    assert len(certificate.relaxed_steps) > 0


@pytest.mark.parametrize("station", [0, 1])
def test_it_is_violated_with_either_threshold_raised(station: int) -> None:
    problem, path = across()
    stations = list(problem.stations)
    raised = replace(stations[station], threshold_dbm=stations[station].threshold_dbm + 40.0)
    stations[station] = raised
    changed = hard(replace(problem, stations=tuple(stations)))
    assert assessed(changed, belief_in(problem, POWERS), path)[1] is Verdict.VIOLATED


def test_the_order_of_stations_does_not_matter() -> None:
    problem, path = across()
    belief = belief_in(problem, POWERS)
    one, verdict = assessed(problem, belief, path)
    other, same = assessed(swapped(problem), swapped_belief(belief), path)
    assert verdict is same
    assert other.min_connectivity == pytest.approx(one.min_connectivity, abs=1e-12)


def raised(problem: Problem, by_db: float) -> Problem:
    higher = tuple(replace(r, threshold_dbm=r.threshold_dbm + by_db) for r in problem.stations)
    return replace(problem, stations=higher)


def any_of(problem: Problem, belief: Belief, path: np.ndarray) -> np.ndarray:
    """P(any) along a path, by each station's own posterior, or by its reading at the place."""
    missed = np.ones(len(path))
    for posterior, radio in zip(belief.posteriors, problem.stations, strict=True):
        power, read = posterior.predict(path), posterior.measurements
        each = ndtr((radio.threshold_dbm - power.mean_db) / power.deviation_db)
        for place, dbm in zip(read.positions_m, read.power_dbm, strict=True):
            each[(path == place).all(axis=1)] = float(dbm < radio.threshold_dbm)
        missed *= each
    return 1.0 - missed


@pytest.mark.parametrize("by_db", [0.0, 22.0])
def test_connectivity_is_that_of_independent_stations(by_db: float) -> None:
    base, path = across()
    problem = raised(base, by_db)
    belief = belief_in(problem, POWERS)
    under = known_in(problem, belief)
    index = index_obstacles(problem.workspace)
    found = verified(problem, index, belief.posterior, path[0], path, **under)
    power, expected = found.power, any_of(problem, belief, path)
    assert power is not None
    threshold = problem.stations[0].threshold_dbm
    chance = connection_probability(power.mean_db, power.deviation_db, threshold)
    assert chance == pytest.approx(expected, abs=1e-12)
    assert found.certificate.min_connectivity == pytest.approx(expected[1:].min(), abs=1e-12)


def test_joint_probability_of_one_step_is_that_of_any() -> None:
    """Two places at once are less sure, and more than if they were independent."""
    base = two_station_problem(horizon=1)
    problem = with_rule(raised(base, 19.0), 0.5, connectivity="joint")
    belief = belief_in(problem, POWERS)
    index = index_obstacles(problem.workspace)
    under = known_in(problem, belief)
    achieved = []
    for steps in (1, 2):
        path = np.array([[18.5, 15.0], [20.0, 15.0], [20.5, 15.0]])[: steps + 1]
        found = verified(problem, index, belief.posterior, path[0], path, **under)
        assert found.certificate.rule is not None
        achieved.append(found.certificate.rule.achieved)
    one, two = any_of(problem, belief, np.array([[20.0, 15.0], [20.5, 15.0]]))
    assert 0.2 < one < 0.99
    assert one - 0.03 < achieved[0] < one + 0.005
    assert one * two - 0.03 < achieved[1] < min(one, two) + 0.005


def test_probable_data_of_one_step_are_the_probability_of_any() -> None:
    """Drawn, less what the interval of 10,000 draws gives away."""
    base = two_station_problem(horizon=1)
    rule = {"connectivity": "data", "data_mbit": 1.0, "deadline_s": 1.0, "rate_mbit_s": 1.0}
    problem = with_rule(raised(base, 20.1), 0.5, **rule)
    path = np.array([[18.5, 15.0], [20.0, 15.0]])
    belief = belief_in(problem, POWERS)
    (expected,) = any_of(problem, belief, path[1:])
    assert 0.2 < expected < 0.9
    under = known_in(problem, belief)
    index = index_obstacles(problem.workspace)
    found = verified(problem, index, belief.posterior, path[0], path, **under)
    assert found.certificate.rule is not None
    assert expected - 0.03 < found.certificate.rule.achieved < expected + 0.005


def with_rule(problem: Problem, p_min: float, **rule: object) -> Problem:
    constraints = replace(problem.constraints, p_min=p_min, rule=ConnectivityRule(**rule))
    return replace(problem, constraints=constraints)


RULES = {
    "average": (0.95, {"connectivity": "average"}),
    "joint": (0.9, {"connectivity": "joint"}),
    "outage": (0.9, {"connectivity": "outage", "outage_max_m": 1.0}),
    "stated": (
        0.9,
        {"connectivity": "each_step", "connected_times_s": (3.0, 13.0), "slack_max_db": 0.0},
    ),
    "data": (
        0.0,
        {"connectivity": "data", "data_mbit": 13.5, "deadline_s": 14.0, "rate_mbit_s": 1.0},
    ),
    "probable data": (
        0.9,
        {"connectivity": "data", "data_mbit": 13.0, "deadline_s": 14.0, "rate_mbit_s": 1.0},
    ),
    "hard": (0.9, {"connectivity": "each_step", "slack_max_db": 0.0}),
}


@pytest.mark.parametrize("name", RULES)
def test_rules_hold_with_both_stations_and_not_with_one(name: str) -> None:
    base, path = across()
    p_min, rule = RULES[name]
    problem = with_rule(base, p_min, **rule)
    belief = belief_in(problem, POWERS)
    certificate, verdict = assessed(problem, belief, path)
    assert verdict is Verdict.VERIFIED, certificate.reasons
    for station in (0, 1):
        left = alone(problem, station), alone_in(belief, station)
        assert assessed(*left, path)[1] is Verdict.VIOLATED


@pytest.mark.parametrize("name", ["average", "outage", "joint", "data", "probable data", "hard"])
def test_slack_is_what_all_thresholds_must_be_lowered_by(name: str) -> None:
    """Missed by s dB, a rule holds with thresholds s dB lower, and not with s - 0.01 dB."""
    base, path = across()
    p_min, rule = RULES[name]
    stations = tuple(replace(r, threshold_dbm=r.threshold_dbm + 25.0) for r in base.stations)
    problem = with_rule(replace(base, stations=stations), p_min, **(rule | {"slack_max_db": 40.0}))
    belief = belief_in(problem, POWERS)
    certificate, verdict = assessed(problem, belief, path)
    assert verdict is Verdict.VERIFIED
    assert certificate.rule is not None
    slack = certificate.rule.slack_db
    assert 0.1 < slack < 40.0
    strict = with_rule(problem, p_min, **(rule | {"slack_max_db": 0.0}))
    for lowered, expected in ((slack + 0.01, Verdict.VERIFIED), (slack - 0.01, Verdict.VIOLATED)):
        lower = tuple(replace(r, threshold_dbm=r.threshold_dbm - lowered) for r in stations)
        assert assessed(replace(strict, stations=lower), belief, path)[1] is expected
