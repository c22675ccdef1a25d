"""The verifier against dense sampling, plain kriging and every constraint broken one at a time."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import scipy.stats
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import (
    CUP,
    RING,
    THRESHOLD_DBM,
    WALL,
    bad_band,
    bad_disc,
    bad_everywhere,
    bad_where,
    belief_of,
    good_everywhere,
    kriged,
    small_problem,
    straight_path,
    verified,
)
from unpriced import unpriced

import planopt.planning.proof.context as predictions
import planopt.planning.proof.verify as single_steps
from planopt.channel.kriging import predict
from planopt.channel.measurements import Measurements
from planopt.channel.posterior import condition
from planopt.planning.certificate import Certificate
from planopt.planning.history import History
from planopt.planning.plan import Verdict
from planopt.planning.proof.verify import STANDING, UNCOMPARED
from planopt.problems.problem import Problem
from planopt.world.clearance import index_obstacles


def judged(
    problem: Problem, path_m: np.ndarray, power_at=good_everywhere, start_m=None
) -> tuple[Certificate, Verdict]:
    """Judge a path of a robot that is where the path begins, or where the test says."""
    path = np.asarray(path_m, dtype=float)
    start = path[0] if start_m is None else np.asarray(start_m, dtype=float)
    belief = belief_of(problem, power_at)
    found = verified(problem, index_obstacles(problem.workspace), belief.posterior, start, path)
    return found.certificate, found.verdict


def assert_rejected(judgement: tuple[Certificate, Verdict], *words: str) -> Certificate:
    """One reason only, with all these words."""
    certificate, verdict = judgement
    assert verdict is Verdict.VIOLATED
    assert len(certificate.reasons) == 1
    assert all(word in certificate.reasons[0] for word in words), certificate.reasons
    return certificate


def assert_verified(judgement: tuple[Certificate, Verdict]) -> Certificate:
    """No reason against it."""
    certificate, verdict = judgement
    assert certificate.reasons == ()
    assert verdict is Verdict.VERIFIED
    return certificate


COORDINATE = st.floats(1.0, 29.0)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(COORDINATE, COORDINATE), min_size=2, max_size=6), st.data())
def test_clearance_against_dense_sampling(places, data):
    """Least distance of a thousand points a segment: never less, and as near as they are dense."""
    polygons = data.draw(st.lists(st.sampled_from([WALL, CUP, RING]), min_size=1, unique=True))
    problem = small_problem(*polygons, speed_max_m_s=100.0)
    path = np.array(places)
    certificate, _ = judged(problem, path)
    obstacles = shapely.union_all(polygons)
    parts = np.linspace(0.0, 1.0, 1001)[:, None]
    samples = np.concatenate([a + parts * (b - a) for a, b in pairwise(path)])
    sampled = shapely.distance(shapely.points(samples), obstacles).min()
    longest = np.linalg.norm(np.diff(path, axis=0), axis=1).max()
    assert sampled - longest / 2000 - 1e-9 <= certificate.min_clearance_m <= sampled + 1e-9


def test_connectivity_against_plain_kriging():
    """Probability and missing dB from equation 1.6 written out and SciPy's normal distribution."""
    problem = small_problem(horizon=12)
    power = bad_where(lambda x, y: (x > 9) & (x < 16) & (y > 11))
    path = straight_path(problem)
    certificate, _ = judged(problem, path, power)
    mean, deviation = kriged(belief_of(problem, power), path[1:])
    probability = scipy.stats.norm.sf(-80.0, mean, deviation)
    assert certificate.min_connectivity == pytest.approx(probability.min(), abs=1e-9)
    margin = mean - scipy.stats.norm.ppf(0.9) * deviation + 80.0
    missed = np.nonzero(margin < 0.0)[0]
    assert missed.size
    assert certificate.relaxed_steps == tuple(missed + 1)
    assert np.allclose(certificate.relaxation_db, -margin[missed], atol=1e-8)
    assert ((probability >= 0.9) == (margin >= 0.0)).all()


def test_connectivity_counts_the_uncertainty_of_theta():
    """With theta estimated the certificate is universal kriging's, solved as one block system."""
    problem = small_problem(horizon=3)
    known = belief_of(problem, bad_disc(20.0, 20.0, 8.0)).posterior
    few = slice(None, None, 30)
    measured = known.measurements
    some = Measurements(measured.positions_m[few], measured.power_dbm[few], measured.censored[few])
    posterior = condition(known.parameters, some)
    path = straight_path(problem)
    index = index_obstacles(problem.workspace)
    certificate = verified(problem, index, posterior, path[0], path).certificate

    parameters, station = known.parameters, problem.stations[0].site

    def trend(q):
        away = np.sqrt(((q - station.position_m) ** 2).sum(1) + station.height_m**2)
        return np.column_stack([np.ones(len(q)), -10.0 * np.log10(away)])

    def covariance(a, b):
        distance = np.linalg.norm(a[:, None] - b[None], axis=2)
        return parameters.shadow_std_db**2 * np.exp(-distance / parameters.decorrelation_m)

    at, n = some.positions_m, len(some)
    block = np.zeros((n + 2, n + 2))
    block[:n, :n] = covariance(at, at) + parameters.multipath_std_db**2 * np.eye(n)
    block[:n, n:] = trend(at)
    block[n:, :n] = trend(at).T
    right = np.vstack([covariance(at, path[1:]), trend(path[1:]).T])
    weights = np.linalg.solve(block, right)
    mean = weights[:n].T @ some.power_dbm
    variance = parameters.shadow_std_db**2 + parameters.multipath_std_db**2
    deviation = np.sqrt(variance - (weights * right).sum(0))
    probability = scipy.stats.norm.sf(-80.0, mean, deviation)
    assert certificate.min_connectivity == pytest.approx(probability.min(), abs=1e-8)


def test_good_plan():
    """Nothing to object to; the certificate says what was found."""
    problem = small_problem(WALL)
    path = straight_path(problem)
    belief = belief_of(problem)
    index = index_obstacles(problem.workspace)
    found = verified(problem, index, belief.posterior, path[0], path, 0.25)
    certificate, verdict = found.certificate, found.verdict
    assert verdict is Verdict.VERIFIED
    assert certificate.min_clearance_m == pytest.approx(19.9 - path[-1, 0])
    assert certificate.kkt_residual == 0.25
    assert certificate.posterior == "exact"
    assert certificate.dynamics_defect <= 0.0
    assert certificate.relaxed_steps == certificate.relaxation_db == ()
    assert certificate.best_margin_db == ()
    assert certificate.path_cost_m is certificate.best_cost_m is None


def test_no_obstacles_is_infinite_clearance():
    """An empty workspace is clear."""
    problem = small_problem()
    assert assert_verified(judged(problem, straight_path(problem))).min_clearance_m == np.inf


def test_one_step():
    """A plan of one step is a plan."""
    problem = small_problem(horizon=1)
    assert_verified(judged(problem, straight_path(problem)))
    certificate = assert_rejected(judged(problem, straight_path(problem), bad_everywhere), "p_min")
    assert certificate.relaxed_steps == (1,)


def test_prediction_is_that_of_the_whole_path():
    """The judgement hands on what it predicted, the robot's own place first."""
    problem = small_problem()
    belief, path = belief_of(problem, bad_disc(8.0, 15.0, 3.0)), straight_path(problem)
    judgement = verified(
        problem, index_obstacles(problem.workspace), belief.posterior, path[0], path
    )
    mean, deviation = kriged(belief, path)
    assert np.allclose(judgement.power.mean_db, mean, atol=1e-8)
    assert np.allclose(judgement.power.deviation_db, deviation, atol=1e-6)


# Through the wall between two samples that are both clear of it; too near to it; into a hole.
@pytest.mark.parametrize(
    ("polygon", "path"),
    [
        (WALL, [(19.2, 15.0), (20.9, 15.0)]),
        (WALL, [(19.0, 15.0), (19.401, 15.0), (19.0, 16.0)]),
        (RING, [(9.3, 15.0), (10.2, 15.0)]),
        (CUP, [(20.0, 15.0), (21.0, 15.0), (23.6, 15.0)]),
        (shapely.box(10, 10, 20, 20), [(15.0, 15.0), (15.5, 15.0)]),
    ],
)
def test_too_near_to_an_obstacle(polygon, path):
    """The whole way counts, not only its samples."""
    problem = small_problem(polygon, speed_max_m_s=3.0)
    assert_rejected(judged(problem, path), "constraints.clearance_m", "0.5")


def test_exactly_at_clearance():
    """The limit itself is kept; a hundredth of a millimetre less is not."""
    problem = small_problem(WALL)
    assert_verified(judged(problem, [(19.4, 12.0), (19.4, 14.0)]))
    assert_rejected(judged(problem, [(19.40001, 12.0), (19.4, 14.0)]), "constraints.clearance_m")


def test_courtyard_is_free():
    """A hole in an obstacle is no obstacle."""
    assert_verified(judged(small_problem(RING), [(18.0, 15.0), (20.0, 15.0), (22.0, 15.0)]))


@pytest.mark.parametrize(
    ("start", "beyond"),
    [
        ((1.0, 15.0), (-0.5, 15.0)),
        ((39.0, 15.0), (40.5, 15.0)),
        ((5.0, 1.0), (5.0, -0.5)),
        ((5.0, 29.0), (5.0, 30.5)),
    ],
)
def test_leaving_the_bounds(start, beyond):
    """On every side; the border itself is inside."""
    problem = small_problem()
    assert_rejected(judged(problem, [start, beyond]), "world.bounds_m")
    assert_rejected(judged(problem, [start, beyond, start]), "world.bounds_m")
    assert_verified(judged(problem, [start, np.clip(beyond, (0, 0), (40, 30))]))


@pytest.mark.parametrize("step", [0, 1, 3])
def test_too_fast(step):
    """One step of four, a tenth of a millimetre too long."""
    lengths = np.full(4, 1.5)
    lengths[step] = 2.0001
    path = np.column_stack([5.0 + np.concatenate([[0.0], lengths.cumsum()]), np.full(5, 15.0)])
    certificate = assert_rejected(judged(small_problem(), path), "robots[0].speed_max_m_s")
    assert certificate.dynamics_defect == pytest.approx(1e-4)
    path[step + 1 :, 0] -= 1e-4
    assert_verified(judged(small_problem(), path))


def test_teleporting_start():
    """A path that begins where the robot is not."""
    path = np.array([(7.0, 15.0), (8.0, 15.0)])
    certificate = assert_rejected(
        judged(small_problem(), path, start_m=(5.0, 15.0)), "robots[0].speed_max_m_s"
    )
    assert certificate.dynamics_defect == pytest.approx(2.0)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("row", [0, 1, 4])
def test_not_finite(value, row):
    """No number, no plan, and no exception."""
    problem = small_problem(WALL)
    path = straight_path(problem)
    path[row, 1] = value
    certificate, verdict = judged(problem, path, start_m=(5.0, 15.0))
    assert verdict is Verdict.VIOLATED
    assert certificate.reasons == ("not finite",)


def test_every_reason_is_given():
    """A plan that breaks everything hears of everything."""
    problem = small_problem(WALL)
    path = [(19.0, 15.0), (45.0, 15.0)]
    certificate, verdict = judged(problem, path, bad_everywhere)
    assert verdict is Verdict.VIOLATED
    for key in ("clearance_m", "bounds_m", "speed_max_m_s", "p_min"):
        assert any(key in reason for reason in certificate.reasons)


AVOIDABLE = bad_disc(9.0, 15.0, 2.5)


@pytest.mark.parametrize(
    "path",
    [
        [(5.0, 15.0), (7.0, 15.0), (9.0, 15.0), (11.0, 15.0), (13.0, 15.0)],
        [(5.0, 17.0), (6.5, 17.0), (8.0, 17.0), (8.6, 15.8), (9.0, 15.0)],
        [(9.0, 18.5), (9.0, 16.6), (9.0, 18.5), (9.0, 20.0), (9.0, 22.0)],
    ],
)
def test_avoidable_place_below_the_bound(path):
    """Midway, at the last step, at the first: a better place was in reach."""
    certificate = assert_rejected(
        judged(unpriced(small_problem()), path, AVOIDABLE), "constraints.p_min", "within reach"
    )
    assert certificate.relaxed_steps
    assert max(certificate.best_margin_db) > 0.0
    assert certificate.path_cost_m is certificate.best_cost_m is None


def test_margin_to_a_hundredth_of_a_db():
    """A threshold a hundredth of a dB too high for the only step is seen; as much lower is kept."""
    path = np.array([(5.0, 15.0), (6.0, 16.0)])
    problem = small_problem(horizon=1)
    mean, deviation = kriged(belief_of(problem), path[1:])
    limit = float(mean[0] - scipy.stats.norm.ppf(0.9) * deviation[0])

    def at(threshold_dbm):
        return judged(unpriced(small_problem(horizon=1, threshold_dbm=threshold_dbm)), path)

    # The belief's mean is the usual threshold, whatever this problem's own is.
    certificate, verdict = at(limit + 0.01)
    assert verdict is Verdict.VIOLATED
    assert all("constraints.p_min" in reason for reason in certificate.reasons)
    assert certificate.relaxation_db == pytest.approx((0.01,), abs=1e-6)
    assert assert_verified(at(limit - 0.01)).min_connectivity == pytest.approx(0.9, abs=1e-2)


def test_start_below_the_bound_leaves_by_the_first_step_that_can():
    """What no place in reach could meet is not held against the plan."""
    problem = unpriced(small_problem())
    path = straight_path(small_problem(), 2.0)
    certificate = assert_verified(judged(problem, path, bad_disc(5.0, 15.0, 3.5)))
    assert certificate.relaxed_steps == (1,)
    assert certificate.relaxation_db[0] > 0.0
    assert certificate.best_margin_db[0] < 0.0


def test_dawdling_below_the_bound():
    """The place next door keeps the bound: it must be taken."""
    problem = unpriced(small_problem())
    around = bad_disc(5.0, 15.0, 1.0)
    leaves = [(5.0, 15.0), (6.4, 16.4), (8.0, 16.4)]
    dawdles = [(5.0, 15.0), (5.0, 15.0), (6.4, 16.4)]
    assert_verified(judged(problem, leaves, around))
    assert_rejected(judged(problem, dawdles, around), "step 1", "constraints.p_min")


def test_dawdling_deep_below_the_bound():
    """The bound can be met from step 3 on: step 8 is too late."""
    problem = unpriced(small_problem(horizon=8))
    x = [5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 7.0, 9.0, 11.0]
    path = np.column_stack([x, np.full(9, 15.0)])
    certificate, verdict = judged(problem, path, bad_disc(5.0, 15.0, 5.0))
    assert max(certificate.best_margin_db) > 10.0
    assert verdict is Verdict.VIOLATED
    x = [5.0, 7.0, 9.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0]
    leaving = judged(problem, np.column_stack([x, np.full(9, 15.0)]), bad_disc(5.0, 15.0, 5.0))
    assert assert_verified(leaving).relaxed_steps == (1, 2)


def priced(price: float, *polygons: shapely.Polygon, **keys: Any) -> Problem:
    """The small problem at a price of outage."""
    problem = small_problem(*polygons, **keys)
    return replace(problem, objective=replace(problem.objective, outage_price=price))


def along(*x: float, y: float = 15.0) -> np.ndarray:
    """Places in a row."""
    return np.column_stack([x, np.full(len(x), y)])


CROSSING = along(10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30)
WIDE, OPEN_WIDE = bad_band(15.0, 25.0), bad_band(15.0, 25.0, open_above_m=20.0)


def test_hole_without_a_way_round_may_be_crossed():
    """A band across the workspace: missing the bound in it is allowed, and said with its cost."""
    certificate = assert_verified(judged(small_problem(), CROSSING, WIDE))
    assert certificate.relaxed_steps == (3, 4, 5, 6, 7)
    assert certificate.best_margin_db == ()
    assert certificate.best_cost_m == pytest.approx(certificate.path_cost_m, abs=10.0)


def test_hole_with_a_way_round_may_not_be_crossed():
    """The same band, open at its upper end: a few metres more would have kept the bound."""
    certificate = assert_rejected(
        judged(small_problem(), CROSSING, OPEN_WIDE), "p_min", "outage_price", "m was found"
    )
    assert certificate.relaxed_steps == (3, 4, 5, 6, 7)
    assert certificate.best_cost_m < 40.0 < 100.0 < certificate.path_cost_m


def test_path_cost_is_the_plans_by_hand():
    """Metres driven, those of steps below the bound by 1 + price (1 - P), and the rest."""
    problem, power = priced(3.0), WIDE
    certificate = assert_verified(judged(problem, CROSSING, power))
    mean, deviation = kriged(belief_of(problem, power), CROSSING)
    score = (mean - THRESHOLD_DBM) / deviation
    share = np.where(score < scipy.stats.norm.ppf(0.9), scipy.stats.norm.sf(score), 0.0)
    lengths = np.linalg.norm(np.diff(CROSSING, axis=0), axis=1)
    driven = (lengths * (1.0 + 3.0 * (share[1:] + share[:-1]) / 2.0)).sum()
    assert certificate.path_cost_m == pytest.approx(driven + 5.0, abs=1e-6)


@pytest.mark.parametrize("price", [0.0, 0.3, 10.0])
def test_the_price_decides_whether_a_hole_may_be_crossed(price):
    """Across costs 10 metres times the price; round its end some 8."""
    problem = priced(price)
    _, verdict = judged(problem, CROSSING, OPEN_WIDE)
    assert (verdict is Verdict.VERIFIED) == (price * 10.0 < 8.0)


def test_without_a_price_only_metres_count():
    """A plan below the bound must not be longer than the shortest path by more than a little."""
    away = np.vstack([CROSSING[:6], along(18, 16, 14, 12, 10, 8, 6, 4, 2)])
    assert_verified(judged(priced(0.0), CROSSING, WIDE))
    assert_rejected(judged(priced(0.0), away, WIDE), "p_min", "outage_price 0")


@pytest.mark.parametrize("beyond_m", [-0.1, 0.1])
def test_just_as_much_dearer_as_is_tolerated(monkeypatch, beyond_m):
    """Whatever the tolerance is: cost equal to it is excused, a little more is not."""
    certificate = assert_verified(judged(small_problem(), CROSSING, WIDE))
    over = certificate.path_cost_m / certificate.best_cost_m - 1.0
    monkeypatch.setattr(single_steps, "COST_LEEWAY_STEPS", 0.0)
    monkeypatch.setattr(single_steps, "COST_TOLERANCE", over - beyond_m / 100.0)
    _, verdict = judged(small_problem(), CROSSING, WIDE)
    assert (verdict is Verdict.VERIFIED) == (beyond_m < 0.0)


@pytest.mark.parametrize("beyond_m", [-0.1, 0.1])
def test_the_leeway_is_of_steps_out_of_contact(monkeypatch, beyond_m):
    """So many longest steps, each metre of them at the whole price."""
    certificate = assert_verified(judged(small_problem(), CROSSING, WIDE))
    over = certificate.path_cost_m - certificate.best_cost_m
    step = small_problem().step_length_m * 11.0
    monkeypatch.setattr(single_steps, "COST_TOLERANCE", 0.0)
    monkeypatch.setattr(single_steps, "COST_LEEWAY_STEPS", (over - beyond_m) / step)
    _, verdict = judged(small_problem(), CROSSING, WIDE)
    assert (verdict is Verdict.VERIFIED) == (beyond_m < 0.0)


@pytest.mark.parametrize("beyond_m", [-0.01, 0.01])
def test_a_run_may_not_waste_more_than_one_plan(beyond_m):
    """What steps below the bound have cost beyond the cheapest paths counts for all of the run."""
    problem = small_problem()
    certificate = assert_verified(judged(problem, CROSSING, WIDE))
    leeway = single_steps.COST_LEEWAY_STEPS * problem.step_length_m * 11.0
    driven = 70.0 + certificate.step_cost_m
    left = single_steps.COST_TOLERANCE * driven + leeway - certificate.step_excess_m
    history = History(crossing_cost_m=70.0, crossing_excess_m=left + beyond_m)
    index, belief = index_obstacles(problem.workspace), belief_of(problem, WIDE)
    judgement = verified(
        problem,
        index,
        belief.posterior,
        CROSSING[0],
        CROSSING,
        history=history,
    )
    assert (judgement.verdict is Verdict.VERIFIED) == (beyond_m < 0.0)
    assert all("of the run so far" in reason for reason in judgement.certificate.reasons)
    # A plan that keeps the bound is not held to account for what has been.
    free = verified(
        problem,
        index,
        belief_of(problem).posterior,
        CROSSING[0],
        CROSSING,
        history=history,
    )
    assert free.verdict is Verdict.VERIFIED


def test_into_a_hole_and_back_is_not_excused():
    """Where nothing leads round it: but driving in it to and fro is dear."""
    back = along(16, 18, 20, 22, 20, 18, 16, 18, 20, 22, 20, 18, 16)
    assert_rejected(judged(small_problem(), back, WIDE), "p_min", "outage_price")


def test_way_round_that_obstacles_close():
    """Open at its upper end, but a building stands there: no way again."""
    block = shapely.box(13.0, 18.0, 27.0, 30.0)
    certificate = assert_verified(judged(small_problem(block), CROSSING, OPEN_WIDE))
    assert certificate.best_cost_m > 100.0


@pytest.mark.parametrize("path", [CROSSING, along(16, 18, 20), along(20, 20.5, 21, 20.5)])
def test_a_mirrored_hole_is_judged_the_same(path):
    """Start and goal exchanged, left and right: costs and verdict stay."""

    def mirrored(q):
        return np.asarray(q) * (-1.0, 1.0) + (40.0, 0.0)

    problem = small_problem()
    robot = replace(problem.robots[0], start_m=(35.0, 15.0), goal_m=(5.0, 15.0))
    other = replace(problem, robots=(robot,))
    one, verdict = judged(problem, path, OPEN_WIDE)
    two, other_verdict = judged(other, mirrored(path), lambda q: OPEN_WIDE(mirrored(q)))
    assert verdict is other_verdict
    assert one.path_cost_m == pytest.approx(two.path_cost_m)
    assert one.best_cost_m == pytest.approx(two.best_cost_m)


def test_better_place_behind_a_wall_is_not_in_reach():
    """All within the closed yard is below the bound but its far end; outside it is fine."""
    yard = shapely.Polygon(
        [(8, 8), (22, 8), (22, 22), (8, 22)], [[(9, 9), (21, 9), (21, 21), (9, 21)]]
    )
    power = bad_where(lambda x, y: (x > 8) & (x < 16) & (y > 8) & (y < 22))
    path = np.column_stack([np.linspace(10.0, 20.0, 6), np.full(6, 15.0)])
    walled = unpriced(small_problem(yard, clearance_m=1.0))
    inside = assert_verified(judged(walled, path, power))
    assert inside.relaxed_steps == (1, 2, 3)
    assert max(inside.best_margin_db) < 0.0
    # Without the walls the place to the left of the start is near enough by step 3.
    assert max(judged(unpriced(small_problem()), path, power)[0].best_margin_db) > 0.0


def test_bound_that_is_met_nowhere():
    """Every step is below, no place is better: an answer with its number, not a plan."""
    problem = small_problem()
    certificate = assert_rejected(
        judged(problem, straight_path(problem), bad_everywhere), "met nowhere", "dB"
    )
    assert certificate.relaxed_steps == (1, 2, 3, 4)
    everywhere = np.stack(np.meshgrid(np.arange(41.0), np.arange(31.0)), axis=-1).reshape(-1, 2)
    mean, deviation = kriged(belief_of(problem, bad_everywhere), everywhere)
    margin = (mean - scipy.stats.norm.ppf(0.9) * deviation).max() - THRESHOLD_DBM
    said = float(re.search(r"by ([0-9.]+) dB", certificate.reasons[0])[1])
    assert said == pytest.approx(-margin, abs=0.01)


def test_bound_that_is_met_nowhere_within_reach():
    """A plan without a price of outage has its number, too."""
    path = straight_path(small_problem())
    certificate = assert_rejected(
        judged(unpriced(small_problem()), path, bad_everywhere), "none of the 4 steps", "dB"
    )
    assert max(certificate.best_margin_db) < -10.0


def test_bound_that_is_never_met_again():
    """Even where nothing in reach keeps it, a plan that stays below throughout is none."""
    problem = unpriced(small_problem(start_m=(20.0, 15.0)))
    path = np.column_stack([np.full(5, 20.0), 15.0 + np.arange(5.0)])
    certificate, verdict = judged(problem, path, bad_band(17.0, 23.0))
    assert verdict is Verdict.VIOLATED
    assert any("none of the 4 steps" in reason for reason in certificate.reasons)


def test_standing_still_is_no_verified_progress():
    """Short of the goal with nothing moving: feasible, not verified; at the goal it is."""
    stand = np.tile((5.0, 15.0), (5, 1))
    certificate, verdict = judged(small_problem(), stand)
    assert verdict is Verdict.FEASIBLE_UNVERIFIED
    assert certificate.reasons == (STANDING,)
    assert_verified(judged(small_problem(), np.tile((34.5, 15.0), (5, 1))))
    assert_verified(judged(unpriced(small_problem()), stand))
    assert_verified(judged(small_problem(), stand + np.arange(5.0)[:, None] * (0.01, 0.0)))


def test_posterior_of_neighbours_beyond_the_limit(monkeypatch):
    """Up to the limit the full posterior, beyond it the nearest measurements, and it says which."""
    problem = small_problem()
    belief, path = belief_of(problem, bad_disc(12.0, 15.0, 3.0)), straight_path(problem)
    index = index_obstacles(problem.workspace)
    count = len(belief.posterior.measurements)

    def certificate():
        return verified(problem, index, belief.posterior, path[0], path).certificate

    monkeypatch.setattr(predictions, "EXACT_LIMIT", count)
    exact = certificate()
    assert exact.posterior == "exact"
    monkeypatch.setattr(predictions, "EXACT_LIMIT", count - 1)
    every = certificate()
    assert every.posterior == "neighbours:192"
    assert np.allclose(every.relaxation_db, exact.relaxation_db, atol=1e-9)
    monkeypatch.setattr(predictions, "NEIGHBOURS_BEYOND", 20)
    fewer = certificate()
    assert fewer.posterior == "neighbours:20"
    assert fewer.min_connectivity != exact.min_connectivity
    assert fewer.min_connectivity == pytest.approx(exact.min_connectivity, abs=0.1)


def test_searches_by_nearby_measurements(monkeypatch):
    """Beyond their own limit the searches look at fewer: the best place is much the same."""
    problem = unpriced(small_problem())
    path = straight_path(small_problem())
    power = bad_disc(5.0, 15.0, 3.5)
    exact = assert_verified(judged(problem, path, power))
    monkeypatch.setattr(predictions, "SEARCH_EXACT_LIMIT", 10)
    nearby = assert_verified(judged(problem, path, power))
    assert nearby.posterior == "exact"
    assert nearby.relaxation_db == exact.relaxation_db
    assert nearby.best_margin_db == pytest.approx(exact.best_margin_db, abs=0.05)


def test_limits_are_those_of_the_design():
    """Design 4.2: exact up to 5,000, at least 192 nearest beyond."""
    assert predictions.EXACT_LIMIT == 5000
    assert predictions.NEIGHBOURS_BEYOND == 192


def test_fewer_measurements_are_never_surer():
    """A true posterior of less data has no smaller deviation."""
    belief = belief_of(small_problem(), bad_disc(12.0, 15.0, 3.0))
    places = np.random.default_rng(0).uniform((0, 0), (40, 30), (50, 2))
    full = predict(belief.posterior, places)
    fewer = predictions.predict_nearby(belief.posterior, places, 10)
    assert (fewer.deviation_db >= full.deviation_db - 1e-9).all()


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_moving_the_scene_changes_no_judgement(seed):
    """Mirrored in a vertical axis: verdict, clearance and connectivity stay."""
    rng = np.random.default_rng(seed)
    problem = small_problem(CUP)
    path = np.vstack([(5.0, 15.0), rng.normal(0.0, 1.2, (4, 2))]).cumsum(axis=0)
    power = bad_disc(*rng.uniform((5, 10), (20, 20)), 3.0)
    certificate, verdict = judged(problem, path, power)

    def mirrored(q):
        return np.asarray(q) * (-1.0, 1.0) + (40.0, 0.0)

    other = replace(
        small_problem(shapely.transform(CUP, mirrored)),
        robots=(replace(problem.robots[0], goal_m=(5.0, 15.0)),),
    )
    flipped, other_verdict = judged(other, mirrored(path), lambda q: power(mirrored(q)))
    assert other_verdict is verdict
    assert flipped.min_clearance_m == pytest.approx(certificate.min_clearance_m, abs=1e-9)
    assert flipped.min_connectivity == pytest.approx(certificate.min_connectivity, abs=1e-9)
    assert flipped.relaxed_steps == certificate.relaxed_steps


@pytest.mark.parametrize("start_x_m", [8.0, 12.0])
def test_nothing_to_compare_with_is_neither_refused_nor_verified(start_x_m):
    """In a corridor that no place of the verifier's grid is in: begun before it, and within."""
    walls = shapely.box(10, 16.1, 30, 27), shapely.box(10, -1, 30, 14.9)
    problem = small_problem(*walls, start_m=(start_x_m, 15.5))
    path = np.column_stack([start_x_m + 1.9 * np.arange(5), np.full(5, 15.5)])
    hole = belief_of(problem, bad_disc(start_x_m + 3.0, 15.5, 2.0))
    index = index_obstacles(problem.workspace)
    found = verified(problem, index, hole.posterior, path[0], path)
    certificate, verdict = found.certificate, found.verdict
    assert certificate.relaxed_steps
    assert verdict is Verdict.FEASIBLE_UNVERIFIED
    assert certificate.reasons == (UNCOMPARED,)
    clear = belief_of(problem)
    assert verified(problem, index, clear.posterior, path[0], path).verdict is Verdict.VERIFIED
