"""What paths are worth with two stations: against draws, single stations and written-out sums."""

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import CONNECT, LEARNING, context_of, terms_problem

from planopt.channel import joint_prediction
from planopt.channel.cholesky import semidefinite_factor
from planopt.objectives.terms.until_connected import counted_legs_m
from planopt.planning.search.local_ranking import LocalRanking
from planopt.planning.values.context import StepContext
from planopt.planning.values.objective_value import ObjectiveValue

DRAWS = 200_000


def a_path(situation: StepContext) -> np.ndarray:
    steps = np.array([1.2, 0.3]) + 0.2 * np.random.default_rng(3).normal(size=(5, 2))
    return situation.position_m + np.cumsum(steps, axis=0)


def alone(situation: StepContext, station: int) -> StepContext:
    """What is known, with one of the stations."""
    problem = replace(situation.problem, stations=(situation.problem.stations[station],))
    posterior = situation.law.posteriors[station]
    return replace(situation, problem=problem, posteriors=(posterior,))


def raised(situation: StepContext, by_db: float) -> StepContext:
    stations = tuple(
        replace(radio, threshold_dbm=radio.threshold_dbm + by_db)
        for radio in situation.problem.stations
    )
    return replace(situation, problem=replace(situation.problem, stations=stations))


def drawn_connected(situation: StepContext, path: np.ndarray) -> np.ndarray:
    """Whether each step is connected to any station, in drawn channels; (DRAWS, N)."""
    generator = np.random.default_rng(11)
    found = np.zeros((DRAWS, len(path)), dtype=bool)
    for posterior, radio in zip(situation.law.posteriors, situation.problem.stations, strict=True):
        law = joint_prediction(posterior, path)
        normal = generator.standard_normal(found.shape)
        power = law.mean_db + normal @ semidefinite_factor(law.covariance_db2).T
        found |= power >= radio.threshold_dbm
    return found


@pytest.mark.parametrize("by_db", [0.0, 6.0])
def test_distance_until_connected_is_that_of_drawn_channels(by_db: float) -> None:
    situation, _ = context_of(terms_problem({**CONNECT, "beyond_m": 20.0}, stations=2))
    situation = raised(situation, by_db)
    path = a_path(situation)
    legs = np.linalg.norm(np.diff(np.vstack([situation.position_m, path]), axis=0), axis=1)
    lost = np.cumprod(~drawn_connected(situation, path), axis=1)
    before = np.hstack([np.ones((DRAWS, 1)), lost])
    charged = before @ np.append(counted_legs_m(legs, situation.step_length_m), 20.0)
    assert -ObjectiveValue(situation)(path) == pytest.approx(charged.mean(), rel=0.03)
    each = [-ObjectiveValue(alone(situation, station))(path) for station in (0, 1)]
    assert -ObjectiveValue(situation)(path) < min(each)


def test_search_looks_at_nearly_the_same_distance() -> None:
    """Filtered in the same way, from the measurements near the path."""
    situation, _ = context_of(terms_problem({**CONNECT, "beyond_m": 20.0}, stations=2))
    situation = raised(situation, 5.0)
    path = a_path(situation)
    (found,) = LocalRanking(situation, path[None])(path[None])
    assert found == pytest.approx(ObjectiveValue(situation)(path), rel=0.03)


@pytest.mark.parametrize(
    "term",
    [
        LEARNING,
        {**LEARNING, "criterion": "T"},
        {**LEARNING, "criterion": "V"},
        {"kind": "mapping", "form": "information"},
        {"kind": "mapping", "form": "average"},
    ],
)
def test_what_measurements_tell_of_each_station_adds_up(term: dict[str, object]) -> None:
    situation, _ = context_of(terms_problem(term, stations=2))
    path = a_path(situation)
    each = [ObjectiveValue(alone(situation, station))(path) for station in (0, 1)]
    assert ObjectiveValue(situation)(path) == pytest.approx(sum(each), rel=1e-9)
