"""Tries with recourse: against the filter by 4 by 4 matrices, and the effect of retreats."""

from dataclasses import replace

import numpy as np
import pytest
from dense_filter import MEASURES, dense_costs
from terms_scene import TRACKING, context_of, terms_problem

from planopt.objectives.tracking import (
    DISCOUNT,
    FilteredTracking,
    Held,
    Retreats,
    Tracking,
    arrival_chance,
    at_ends,
    delayed_costs,
    discounted,
    last_arrivals,
    left,
    recourse_costs,
    retreats_of,
)
from planopt.targets.information_filter import (
    Sensor,
    TargetModel,
    predicted_information,
    sensing_information,
)

STEPS, BEYOND, LONGEST_M = 4, 5, 2.0
SENSOR = Sensor(0.008, 0.08, 1.0)
TARGET = np.array([10.0, 3.0]) + np.arange(1, STEPS + BEYOND + 1)[:, None] * (0.6, 0.1)
MODEL = TargetModel(0.5, 0.01 * np.eye(2))
SETTINGS = FilteredTracking(Tracking(-40.0, SENSOR, TARGET), MODEL, np.diag([4.0, 4.0, 10.0, 10.0]))
NOWHERE = Retreats(np.zeros((0, 2)), np.zeros((0, STEPS + BEYOND)), LONGEST_M, 0)
ALONE = np.zeros(STEPS + BEYOND)
WAYS = np.array(
    [
        [[2.0, 0.0], [4.0, 0.0], [6.0, 1.0], [6.0, 1.0]],
        [[1.0, 1.0], [1.0, 1.0], [1.0, 1.0], [1.0, 1.0]],
        [[2.0, 0.0], [4.0, 0.0], [6.0, 0.0], [8.0, 0.0]],
    ]
)


def traced(places_m, arrives):
    """Sum of tr P of the position by the filter of 4 by 4 matrices, for certain losses."""
    sensing = sensing_information(SENSOR, places_m, TARGET)
    return dense_costs(0.5 * arrives * sensing, SETTINGS).sum()


@pytest.mark.parametrize("criterion", list(MEASURES))
def test_one_axis_is_the_whole_filter(criterion):
    """The weighted sum of each criterion, for several sequences of packets at once."""
    weight = np.array([1.0, 0.5, 2.0, 1.0, 1.5, 0.0, 1.0, 1.0, 3.0])
    settings = replace(SETTINGS.weighted(weight), criterion=criterion)
    received = np.random.default_rng(0).exponential(2.0, (7, len(TARGET)))
    expected = [weight @ dense_costs(each, settings) for each in received]
    np.testing.assert_allclose(left(received, settings), expected, rtol=1e-9)


def test_steps_beyond_the_horizon_are_at_the_last_velocity():
    few = replace(
        SETTINGS, tracking=replace(SETTINGS.tracking, target_m=TARGET[:3], weight=np.full(3, 2.0))
    )
    found = few.extended(len(TARGET) - 3).tracking
    np.testing.assert_allclose(found.target_m, TARGET)
    np.testing.assert_array_equal(found.weight, [2.0] * 3 + [1.0] * (len(TARGET) - 3))


@pytest.mark.parametrize("chance", [0.0, 1.0])
def test_certain_ends_are_those_of_the_recursion(chance):
    """Who surely is connected stays at the end of its path; who surely is not tells nothing."""
    sent = np.array([[1.0, 0.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0], [0.0, 1.0, 1.0, 0.0]])
    for way, arrives in zip(WAYS, sent, strict=True):
        stays = np.linalg.norm(way - way[-1], axis=1) == 0.0
        stays[: int(np.flatnonzero(~stays).max(initial=-1)) + 1] = False
        chances = np.where(stays, chance, arrives)
        found = recourse_costs(way[None], chances[None], NOWHERE, ALONE, SETTINGS)
        places = np.vstack([way, np.repeat(way[-1:], BEYOND, axis=0)])
        expected = np.append(chances, np.full(BEYOND, chance))
        np.testing.assert_allclose(found, [traced(places, expected)], rtol=1e-12)


def test_a_try_is_the_mixture_of_both_ends():
    """The cost is linear in the chance at the end."""
    chances = np.array([[0.9, 0.5, 0.4, 0.4], [0.4] * 4, [0.9, 0.8, 0.7, 0.4]])
    ends = [
        recourse_costs(
            WAYS, np.where([*[[False] * 3 + [True]] * 3], p, chances), NOWHERE, ALONE, SETTINGS
        )
        for p in (0.0, 0.4, 1.0)
    ]
    np.testing.assert_allclose(ends[1], 0.6 * ends[0] + 0.4 * ends[2], rtol=1e-12)


def test_retreats_never_cost_and_are_reached_in_time():
    """A place that is too far for all steps changes nothing; a near one lessens what is left."""
    chances = np.full((3, STEPS), 0.5)
    alone = recourse_costs(WAYS, chances, NOWHERE, ALONE, SETTINGS)
    far = retreats_of(np.array([[60.0, 60.0]]), np.zeros(len(TARGET)), SETTINGS, LONGEST_M)
    np.testing.assert_array_equal(recourse_costs(WAYS, chances, far, ALONE, SETTINGS), alone)
    near = retreats_of(np.array([[9.0, 3.0]]), np.zeros(len(TARGET)), SETTINGS, LONGEST_M)
    assert np.all(recourse_costs(WAYS, chances, near, ALONE, SETTINGS) < alone)


def test_the_best_retreat_within_reach_is_taken_at_every_step():
    generator = np.random.default_rng(3)
    places, told = generator.uniform(0.0, 12.0, (7, 2)), generator.uniform(0.0, 5.0, (7, 9))
    retreats = Retreats(places, told, LONGEST_M, 0)
    stops, arrivals = WAYS[:, -1], np.array([2, 0, 3])
    expected = np.zeros((3, 9))
    for number, (stop, arrival) in enumerate(zip(stops, arrivals, strict=True)):
        for k in range(9):
            for place, each in zip(places, told, strict=True):
                if np.linalg.norm(place - stop) <= LONGEST_M * (k - arrival):
                    expected[number, k] = max(expected[number, k], each[k])
    np.testing.assert_array_equal(retreats.best(stops, arrivals), expected)


def test_the_terminal_weight_is_of_one_step():
    """Steps beyond the horizon have the weight of the others."""
    problem = terms_problem({**TRACKING, "form": "recourse", "terminal_weight": 5.0}, horizon=3)
    context, _ = context_of(problem)
    (term,) = problem.terms
    alone = replace(term, terminal_weight=1.0)
    way = np.tile(context.position_m, (1, 3, 1))
    chance = np.full((1, 3), 0.5)
    heavy, light = (each.probe_values(context, way, chance)[0] for each in (term, alone))
    far = replace(term, terminal_weight=1.0, step_weights=(1.0, 1.0, 5.0, 1.0))
    assert light < heavy == pytest.approx(far.probe_values(context, way, chance)[0], rel=1e-12)


def test_who_stands_is_taken_for_standing_until_the_plan_ends():
    """Retreats within reach make up for nothing that a plan puts off, but for a try that failed."""
    target = retreats_of(np.zeros((0, 2)), np.ones(len(TARGET)), SETTINGS, LONGEST_M)
    start = np.zeros(2)
    standing = np.tile(start, (STEPS, 1))
    driving = np.cumsum(np.tile([LONGEST_M, 0.0], (STEPS, 1)), axis=0)
    early = np.vstack([driving[:2], driving[1], driving[1]])
    ways = np.stack([standing, driving, early])
    arrivals = last_arrivals(ways)
    np.testing.assert_array_equal(arrivals, [0, STEPS - 1, 1])
    succeeded, failed = at_ends(ways, arrivals, target, SETTINGS)
    stays = sensing_information(SENSOR, ways[:, -1, None], TARGET)
    np.testing.assert_array_equal(succeeded[:, :STEPS], stays[:, :STEPS])
    best = target.best(ways[:, -1], arrivals)
    np.testing.assert_array_equal(succeeded[:, STEPS:], np.maximum(stays, best)[:, STEPS:])
    np.testing.assert_array_equal(failed[0, :STEPS], 0.0)
    np.testing.assert_array_equal(failed[1:], best[1:])
    np.testing.assert_array_equal(failed[0, STEPS:], best[0, STEPS:])
    costs = recourse_costs(ways, np.ones((3, STEPS)), target, ALONE, SETTINGS)
    assert costs[1] < costs[0]


TOTAL = STEPS + BEYOND
FIRST = replace(SETTINGS, held=Held(SETTINGS.information, np.zeros(0), np.zeros(0)))
OUT = WAYS[2]
"""Four steps of 2 m along the x axis, to (8, 0)."""


def home_at(place_m, information=0.0):
    """One place that is known to be connected, with the information of its packets."""
    return Retreats(np.array([place_m]), np.full((1, TOTAL), information), LONGEST_M, 1)


@pytest.mark.parametrize(("home_m", "steps_back"), [((4.0, 0.0), 2), ((3.0, 0.0), 3)])
def test_excursion_is_reported_on_return(home_m, steps_back):
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


def test_packets_of_both_kinds_agree_if_all_is_connected():
    """With others' packets, and places to go to."""
    retreats = retreats_of(np.array([[9.0, 3.0], [4.0, 0.0]]), np.ones(TOTAL), SETTINGS, LONGEST_M)
    others, chance = np.linspace(0.0, 2.0, TOTAL), np.ones((3, STEPS))
    found = delayed_costs(WAYS, chance, retreats, others, FIRST)
    raw = recourse_costs(WAYS, chance, retreats, others, SETTINGS)
    np.testing.assert_allclose(found, raw, rtol=1e-12)


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


def test_step_is_reported_by_the_best_later_packet():
    """Against a loop; measurements held are delivered by any packet of the path."""
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
    raw, _ = context_of(problem)
    held = Held(raw.aim.information, np.zeros(0), np.zeros(0))
    sent = replace(raw, aim=replace(raw.aim, held=held))
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
