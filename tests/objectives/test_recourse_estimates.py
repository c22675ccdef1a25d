"""Tries where packets have estimates: an excursion by 4 by 4 matrices, and what delay changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dense_filter import dense_costs
from terms_scene import TRACKING, situation_of, terms_problem
from test_tracking_recourse import (
    ALONE,
    BEYOND,
    LONGEST_M,
    NOWHERE,
    SENSOR,
    SETTINGS,
    STEPS,
    TARGET,
    WAYS,
)

from planopt.objectives.tracking import (
    DISCOUNT,
    Held,
    Retreats,
    arrival_chance,
    delayed_costs,
    discounted,
    recourse_costs,
    retreats_of,
)
from planopt.targets.information_filter import predicted_information
from planopt.targets.sensor import sensing_information

TOTAL = STEPS + BEYOND
FIRST = replace(SETTINGS, held=Held(SETTINGS.information, np.zeros(0), np.zeros(0)))
OUT = WAYS[2]
"""Four steps of 2 m along the x axis, to (8, 0)."""


def home_at(place_m, information=0.0):
    """One place that is known to be connected, with the information of its packets."""
    return Retreats(np.array([place_m]), np.full((1, TOTAL), information), LONGEST_M, 1)


@pytest.mark.parametrize(("home_m", "steps_back"), [((4.0, 0.0), 2), ((3.0, 0.0), 3)])
def test_an_excursion_is_told_of_on_return(home_m, steps_back):
    """Out of contact from the second step on; back home all is known, and nothing new is sensed."""
    chance = np.array([[1.0, 0.0, 0.0, 0.0]])
    found = delayed_costs(OUT[None], chance, home_at(home_m), ALONE, FIRST)
    # It is at the stop at the end of step 3, counted from 0.
    share = np.minimum(np.arange(1, BEYOND + 1) / steps_back, 1.0)
    back = OUT[-1] + share[:, None] * (np.array(home_m) - OUT[-1])
    places = np.vstack([OUT, back])
    at_home = STEPS - 1 + steps_back
    # From home on the place brings nothing, as `home_at` has it.
    senses = np.where(np.arange(TOTAL) < at_home, 1.0, 0.0)
    sensing = sensing_information(SENSOR, places, TARGET)
    known = dense_costs(0.5 * senses * sensing, SETTINGS)
    senses[1:] = 0.0
    both = dense_costs(0.5 * senses * sensing, SETTINGS), known
    expected = np.where(np.arange(TOTAL) < at_home, *both).sum()
    np.testing.assert_allclose(found, [expected], rtol=1e-12)


def test_where_every_place_is_connected_packets_of_both_kinds_tell_the_same():
    """With others' packets, and places to go to."""
    retreats = retreats_of(np.array([[9.0, 3.0], [4.0, 0.0]]), np.ones(TOTAL), SETTINGS, LONGEST_M)
    others, chance = np.linspace(0.0, 2.0, TOTAL), np.ones((3, STEPS))
    found = delayed_costs(WAYS, chance, retreats, others, FIRST)
    raw = recourse_costs(WAYS, chance, retreats, others, SETTINGS)
    np.testing.assert_allclose(found, raw, rtol=1e-12)


def test_who_never_is_connected_tells_nothing():
    """Without a chance and without a way back what is sensed is lost, as that of measurements."""
    chance = np.zeros((3, STEPS))
    found = delayed_costs(WAYS, chance, NOWHERE, ALONE, FIRST)
    raw = recourse_costs(WAYS, chance, NOWHERE, ALONE, SETTINGS)
    np.testing.assert_allclose(found, raw, rtol=1e-12)


def test_telling_later_never_costs_more_than_losing_and_more_the_later():
    """A good place that is farther away is come to later."""
    chances = np.random.default_rng(5).uniform(0.0, 1.0, (3, STEPS))
    away = WAYS[:, -1] + np.array([0.0, 1.0])
    for number, way in enumerate(WAYS):
        chance = chances[number : number + 1]
        near, far = (home_at(away[number] + [0.0, further], 50.0) for further in (0.0, 6.0))
        costs = [
            delayed_costs(way[None], chance, home, ALONE, FIRST)[0] for home in (near, far, NOWHERE)
        ]
        lost = recourse_costs(way[None], chance, NOWHERE, ALONE, SETTINGS)[0]
        assert costs[0] < costs[1] < costs[2] <= lost


def test_what_is_held_comes_with_the_first_packet():
    """Measurements before the plan: one arrival now, against the filter of 4 by 4 matrices."""
    held = Held(SETTINGS.information, np.array([0.2, 0.0]), np.array([0.0, 1.5]))
    states = []
    for sent in (np.zeros(2), held.sent):
        matrix = SETTINGS.information
        for known, each in zip(held.known, sent, strict=True):
            matrix = predicted_information(SETTINGS.model, matrix)
            matrix[:2, :2] += (known + each) * np.eye(2)
        states.append(matrix)
    settings = replace(SETTINGS, information=states[0], held=held)
    for certain, start in enumerate(states):
        chance = np.full((1, STEPS), float(certain))
        found = delayed_costs(OUT[None], chance, NOWHERE, ALONE, settings)
        raw = recourse_costs(
            OUT[None], chance, NOWHERE, ALONE, replace(SETTINGS, information=start)
        )
        np.testing.assert_allclose(found, raw, rtol=1e-12)


def test_a_step_is_told_of_by_the_best_packet_since():
    """Against a loop; what is held, by any packet of the way."""
    chance = np.random.default_rng(7).uniform(0.0, 1.0, (2, STEPS))
    expected = np.zeros((STEPS, 2 + STEPS, 2))
    for k in range(STEPS):
        for s in range(k + 1):
            expected[k, 2 + s] = chance[:, s : k + 1].max(axis=1)
        expected[k, :2] = chance[:, : k + 1].max(axis=1)
    np.testing.assert_array_equal(arrival_chance(chance, 2), expected)


def test_later_steps_are_discounted():
    """By the same factor every step, where packets have estimates alone."""
    weight = discounted(SETTINGS).tracking.weight
    np.testing.assert_allclose(weight[1:] / weight[:-1], DISCOUNT, rtol=1e-12)
    assert weight[0] == SETTINGS.tracking.weight[0]
    problem = terms_problem({**TRACKING, "form": "recourse"}, horizon=3)
    raw, _ = situation_of(problem)
    if raw.information is None:
        raise AssertionError("the station knows something")
    sent = replace(raw, held=Held(raw.information, np.zeros(0), np.zeros(0)))
    (term,) = problem.terms
    way, chance = np.tile(raw.position_m, (1, 3, 1)), np.ones((1, 3))
    values = [term.probe_values(each, way, chance)[0] for each in (raw, sent)]
    assert 0.0 < values[1] < values[0]


def test_who_stands_sets_out_when_the_plan_ends():
    """Out of contact throughout: all is known four steps after the plan, and nothing before."""
    standing = np.tile(OUT[-1], (STEPS, 1))
    found = delayed_costs(standing[None], np.zeros((1, STEPS)), home_at((0.0, 0.0)), ALONE, FIRST)
    share = np.minimum(np.arange(1, BEYOND + 1) / 4.0, 1.0)
    places = np.vstack([standing, OUT[-1] * (1.0 - share[:, None])])
    at_home = STEPS - 1 + 4
    senses = np.where(np.arange(TOTAL) < at_home, 1.0, 0.0)
    sensing = sensing_information(SENSOR, places, TARGET)
    both = (dense_costs(0.5 * each * sensing, SETTINGS) for each in (np.zeros(TOTAL), senses))
    expected = np.where(np.arange(TOTAL) < at_home, *both).sum()
    np.testing.assert_allclose(found, [expected], rtol=1e-12)
