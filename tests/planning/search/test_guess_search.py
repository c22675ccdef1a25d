"""Starts of a plan: what becomes of the last plan."""

from dataclasses import replace

import numpy as np
from terms_scene import CONNECT, context_of, scorer_of, terms_problem

from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.plan import history_of
from planopt.planning.search.guess_search import GuessSearch, without_waiting
from planopt.planning.values.objective_value import ObjectiveValue


def test_waiting_is_put_off() -> None:
    """The same places in the same order, first those that lead on."""
    here = np.array([3.0, 4.0])
    path = here + np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    expected = here + np.array([[1.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 0.0], [2.0, 0.0]])
    np.testing.assert_array_equal(without_waiting(here, path), expected)
    np.testing.assert_array_equal(without_waiting(here, expected), expected)
    standing = np.tile(here, (4, 1))
    np.testing.assert_array_equal(without_waiting(here, standing), standing)


def test_a_search_does_not_begin_with_the_waiting_of_the_last_plan() -> None:
    """The same plan without its waiting is another start, and a better one."""
    problem = terms_problem(CONNECT, horizon=6)
    context, belief = context_of(problem)
    context = replace(context, state=np.array([3.5, 2.6]))
    scorer, ground = scorer_of(context, belief)
    polished = HorizonPlanner(problem, ground).plan(context, scorer).positions_m[1:]
    waits = np.vstack([np.tile(context.position_m, (2, 1)), polished[:-2]])
    search = GuessSearch(problem, ground)
    offered = without_waiting(context.position_m, waits)
    worth = ObjectiveValue(context)
    assert worth(offered) > worth(waits)
    assert search.find_guesses(context, waits)[0].value >= worth(offered)
    # No other search has it.
    assert search.find_guesses(context, None)[0].value < worth(offered)


def test_places_missed_beside_connected_measurements_are_tried_once() -> None:
    """No measurement is taken there, so that the run itself has to remember them."""
    problem = terms_problem(CONNECT)
    context, _ = context_of(problem)
    at, power = context.posterior.measurements, context.posterior.measurements.power_dbm
    connected = at.positions_m[power >= problem.stations[0].threshold_dbm]
    below = at.positions_m[power < problem.stations[0].threshold_dbm]
    beside = connected + 0.1
    apart = np.linalg.norm(beside[:, None] - below, axis=2).min(axis=1)
    place = beside[apart > problem.channel.measure_spacing_m][:1]
    assert len(place) == 1 and context.probing.is_open(place).all()
    track = np.vstack([context.position_m, place, context.position_m, context.position_m])
    for last, tried in (([False, False, False], False), ([True, False, False], True)):
        history = history_of(problem, track, np.array(last))
        after = replace(context, history=history)
        assert after.probing.is_open(place).all() == tried
    far = context.position_m + 12.0
    assert after.probing.is_open(far[None]) == context.probing.is_open(far[None])
