"""Values and slopes of many paths at once: those of the exact objective value, one by one."""

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import CONNECT, ENERGY, LEARNING, TRACKING, context_of, mapping, terms_problem

from planopt.objectives.stage_power import CUSP_ROUNDING
from planopt.planning.search.local_ranking import LocalRanking
from planopt.planning.values.objective_value import ObjectiveValue


def ways_of(context, count=7):
    rng = np.random.default_rng(2)
    shape = (count, context.problem.planner.horizon, 2)
    return context.position_m + np.cumsum(rng.normal(size=shape), axis=1)


@pytest.mark.parametrize(
    "terms",
    [
        (TRACKING,),
        *[({**LEARNING, "criterion": kind},) for kind in "DTAV"],
        *[(mapping(form),) for form in ("two_layer", "path", "information", "average")],
        (TRACKING, {**LEARNING, "weight": 3.0}, {**mapping("path"), "weight": 0.2}, ENERGY),
    ],
)
@pytest.mark.parametrize(("horizon", "stations"), [(1, 1), (6, 1), (6, 2)])
def test_values_are_the_exact_worths(terms, horizon, stations):
    """All 40 measurements are near: nothing but rounding is between the two.

    But for the average, which is ranked by every k-th place of the region only.
    """
    if stations > 1 and terms[0].get("form") == "two_layer":
        return  # refused when it is loaded
    context, _ = context_of(terms_problem(*terms, horizon=horizon, stations=stations))
    ways, worth = ways_of(context), ObjectiveValue(context)
    exact = [worth(way) for way in ways]
    near = 3e-2 if terms[0].get("form") == "average" else 2e-4
    np.testing.assert_allclose(LocalRanking(context, ways)(ways), exact, rtol=near, atol=2e-4)


def test_probes_are_predicted_without_gates() -> None:
    """Near old readings a measured term's gates close, but powers there stay correlated."""
    context, _ = context_of(terms_problem(CONNECT, {**mapping("information"), "weight": 0.0}))
    paths_m = context.posterior.measurements.positions_m[:30].reshape(6, 5, 2)
    exact = [ObjectiveValue(context)(path_m) for path_m in paths_m]
    np.testing.assert_allclose(LocalRanking(context, paths_m)(paths_m), exact, atol=2e-3)


def chances(context, ways, threshold_dbm):
    """P(connected) at every place of the ways."""
    found = context.posterior.connectivity(ways.reshape(-1, 2), threshold_dbm)
    return found.reshape(ways.shape[:2])


def test_ways_that_miss_the_bound_come_last():
    context, _ = context_of(terms_problem(LEARNING))
    ways = ways_of(context, 60)
    chance = chances(context, ways, -32.0)
    station = replace(context.problem.stations[0], threshold_dbm=-32.0)
    free = replace(context, problem=replace(context.problem, stations=(station,)))
    bounded = replace(free.problem, constraints=replace(free.problem.constraints, p_min=0.5))
    context = replace(context, problem=bounded)
    values, worths = LocalRanking(context, ways)(ways), LocalRanking(free, ways)(ways)
    kept = (chance >= 0.5).all(axis=1)
    assert 0 < kept.sum() < len(ways)
    np.testing.assert_allclose(values[kept], worths[kept])
    badly = (chance < 0.4).any(axis=1)
    assert values[kept].min() > values[badly].max()


STEP_M = 1e-2


def differences(value, ways):
    """Central differences of `value` by all places."""
    found = np.zeros(ways.shape)
    for k in range(ways.shape[1]):
        for axis in range(2):
            step = np.zeros(ways.shape[1:])
            step[k, axis] = STEP_M
            found[:, k, axis] = (value(ways + step) - value(ways - step)) / (2.0 * STEP_M)
    return found


def smooth_ways(context):
    """Ways none of whose places are near a cusp: a measurement, or another place."""
    rng = np.random.default_rng(2)
    parameters = context.posterior.parameters
    ways = context.position_m + np.cumsum(rng.normal(size=(60, 4, 2)), axis=1)
    others = np.concatenate(
        [np.tile(context.posterior.measurements.positions_m, (60, 1, 1)), ways], axis=1
    )
    apart = np.linalg.norm(ways[:, :, None] - others[:, None], axis=3)
    apart[apart == 0.0] = np.inf
    kept = apart.min(axis=(1, 2)) > 2.0 * CUSP_ROUNDING * parameters.decorrelation_m
    assert kept.sum() > 5
    return ways[kept][:6]


@pytest.mark.parametrize(
    "terms",
    [
        *[({**LEARNING, "criterion": kind},) for kind in "DTAV"],
        *[(mapping(form),) for form in ("two_layer", "path", "information", "average")],
        ({**LEARNING, "weight": 3.0}, {**mapping("path"), "weight": 0.2}, ENERGY),
    ],
)
@pytest.mark.parametrize("stations", [1, 2])
def test_slopes_are_those_of_the_values(terms, stations):
    """In single precision; of one station, and added up over two."""
    if stations > 1 and terms[0].get("form") == "two_layer":
        return  # refused when it is loaded
    context, _ = context_of(terms_problem(*terms, horizon=4, stations=stations))
    ways = smooth_ways(context)
    ranking = LocalRanking(context, ways)
    _, slopes = ranking.slopes(ways)
    wanted = differences(lambda moved: ranking.slopes(moved)[0], ways)
    np.testing.assert_allclose(slopes, wanted, atol=2e-2 * np.abs(wanted).max())


@pytest.mark.parametrize("rule", ["each_step", "joint"])
def test_slopes_lead_to_where_the_bound_is_kept(rule):
    """Where ways miss it, what is missing counts far more than all else."""
    context, _ = context_of(terms_problem(mapping("information"), horizon=4))
    ways = smooth_ways(context)
    station = replace(context.problem.stations[0], threshold_dbm=-32.0)
    constraints = replace(
        context.problem.constraints,
        p_min=0.8,
        rule=replace(context.problem.constraints.rule, connectivity=rule),
    )
    problem = replace(context.problem, stations=(station,), constraints=constraints)
    bounded = LocalRanking(replace(context, problem=problem), ways)
    free = LocalRanking(context, ways)
    values, slopes = bounded.slopes(ways)
    missed = values < free(ways) - 1e-6
    assert missed.any()
    wanted = differences(lambda moved: bounded.slopes(moved)[0], ways)[missed]
    np.testing.assert_allclose(slopes[missed], wanted, atol=2e-2 * np.abs(wanted).max())
