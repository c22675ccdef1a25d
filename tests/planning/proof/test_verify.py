"""The verifier against dense sampling, plain kriging and mixtures of channels."""

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

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
from scipy.stats import norm
from terms_scene import TRACKING, terms_problem
from unpriced import unpriced

import planopt.planning.proof.rule as predictions
from planopt import Measurements, Problem, Verdict, check
from planopt.channel import Prediction, condition, marginalise
from planopt.channel.connectivity_law import UncertainParameters, mixture_quantile_dbm
from planopt.channel.kriging import bound_margin_db
from planopt.planning.certificate import Certificate
from planopt.planning.proof.rule import uncertain_law
from planopt.planning.proof.verify import UNCOMPARED
from planopt.planning.solve import simulate, solve
from planopt.world import index_obstacles


def assessed(
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
    certificate, _ = assessed(problem, path)
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
    certificate, _ = assessed(problem, path, power)
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


def test_margin_to_a_hundredth_of_a_db():
    """A threshold a hundredth of a dB too high for the only step is seen; as much lower is kept."""
    path = np.array([(5.0, 15.0), (6.0, 16.0)])
    problem = small_problem(horizon=1)
    mean, deviation = kriged(belief_of(problem), path[1:])
    limit = float(mean[0] - scipy.stats.norm.ppf(0.9) * deviation[0])

    def at(threshold_dbm):
        return assessed(unpriced(small_problem(horizon=1, threshold_dbm=threshold_dbm)), path)

    # The belief's mean is the usual threshold, whatever this problem's own is.
    certificate, verdict = at(limit + 0.01)
    assert verdict is Verdict.VIOLATED
    assert all("constraints.p_min" in reason for reason in certificate.reasons)
    assert certificate.relaxation_db == pytest.approx((0.01,), abs=1e-6)
    assert assert_verified(at(limit - 0.01)).min_connectivity == pytest.approx(0.9, abs=1e-2)


def test_bound_that_is_met_nowhere():
    """Every step is below, no place is better: an answer with its number, not a plan."""
    problem = small_problem()
    certificate = assert_rejected(
        assessed(problem, straight_path(problem), bad_everywhere), "met nowhere", "dB"
    )
    assert certificate.relaxed_steps == (1, 2, 3, 4)
    everywhere = np.stack(np.meshgrid(np.arange(41.0), np.arange(31.0)), axis=-1).reshape(-1, 2)
    mean, deviation = kriged(belief_of(problem, bad_everywhere), everywhere)
    margin = (mean - scipy.stats.norm.ppf(0.9) * deviation).max() - THRESHOLD_DBM
    said = float(re.search(r"by ([0-9.]+) dB", certificate.reasons[0])[1])
    assert said == pytest.approx(-margin, abs=0.01)


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
    exact = assert_verified(assessed(problem, path, power))
    monkeypatch.setattr(predictions, "SEARCH_EXACT_LIMIT", 10)
    nearby = assert_verified(assessed(problem, path, power))
    assert nearby.posterior == "exact"
    assert nearby.relaxation_db == exact.relaxation_db
    assert nearby.best_margin_db == pytest.approx(exact.best_margin_db, abs=0.05)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_moving_the_scene_changes_no_judgement(seed):
    """Mirrored in a vertical axis: verdict, clearance and connectivity stay."""
    rng = np.random.default_rng(seed)
    problem = small_problem(CUP)
    path = np.vstack([(5.0, 15.0), rng.normal(0.0, 1.2, (4, 2))]).cumsum(axis=0)
    power = bad_disc(*rng.uniform((5, 10), (20, 20)), 3.0)
    certificate, verdict = assessed(problem, path, power)

    def mirrored(q):
        return np.asarray(q) * (-1.0, 1.0) + (40.0, 0.0)

    other = replace(
        small_problem(shapely.transform(CUP, mirrored)),
        robots=(replace(problem.robots[0], goal_m=(5.0, 15.0)),),
    )
    flipped, other_verdict = assessed(other, mirrored(path), lambda q: power(mirrored(q)))
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


SEED = 3


def all_uncertain(problem):
    rule = replace(problem.constraints.rule, parameter_uncertainty="all")
    return replace(problem, constraints=replace(problem.constraints, rule=rule))


@pytest.mark.parametrize("p_min", [0.5, 0.9, 0.99])
def test_quantile_of_a_mixture(p_min):
    """The mixture's own distribution function says `p_min` there."""
    weights = np.array([0.5, 0.3, 0.2])
    parts = [
        Prediction(np.array([-60.0, -70.0]), np.array([3.0, 1.0])),
        Prediction(np.array([-62.0, -71.0]), np.array([5.0, 4.0])),
        Prediction(np.array([-55.0, -70.0]), np.array([8.0, 1.0])),
    ]
    found = mixture_quantile_dbm(weights, parts, p_min)
    above = sum(
        w * norm.sf(found, p.mean_db, p.deviation_db) for w, p in zip(weights, parts, strict=True)
    )
    np.testing.assert_allclose(above, p_min, atol=1e-12)


def test_quantile_where_parts_are_far_apart_or_certain():
    """Newton's method would leave such laws: bisection holds it, and no NaN comes of it."""
    weights = np.array([0.6, 0.4])
    parts = [
        Prediction(np.array([-90.0, -80.0, -80.0]), np.array([0.01, 0.0, 0.0])),
        Prediction(np.array([-30.0, -70.0, -70.0]), np.array([0.01, 3.0, 0.0])),
    ]
    found = mixture_quantile_dbm(weights, parts, 0.7)
    assert found[0] == pytest.approx(-90.0 + 0.01 * norm.isf(0.5), abs=1e-9)
    # The certain part counts whole at what it is, and not above.
    assert found[1:] == pytest.approx([-80.0, -80.0], abs=1e-6)


def test_margin_is_that_of_the_mixture():
    """At any place: zero margin where the mixture's chance of connection is p_min."""
    problem = all_uncertain(terms_problem(TRACKING, p_min=0.9))
    posterior = solve(problem, seed=SEED).belief.posterior
    law = uncertain_law(problem, [posterior])
    assert isinstance(law, UncertainParameters)
    places = np.random.default_rng(1).uniform(5.0, 35.0, (40, 2))
    power = law.power(places)
    marginal = marginalise(posterior.parameters, posterior.measurements)
    for place, mean, deviation in zip(places, power.mean_db, power.deviation_db, strict=True):
        threshold = float(bound_margin_db(mean, deviation, 0.0, 0.9))
        assert marginal.connectivity(place[None], threshold)[0] == pytest.approx(0.9, abs=1e-9)
    assert uncertain_law(terms_problem(TRACKING, p_min=0.9), [posterior]) is None


def test_plan_keeps_the_bound_of_the_mixture(tmp_path: Path):
    """Planned, driven and checked; where it binds the mixture's chance is p_min."""
    problem = all_uncertain(terms_problem(TRACKING, p_min=0.92, horizon=4, max_steps=3))
    solution = solve(problem, seed=SEED)
    plan, posterior = solution.plans[0], solution.belief.posterior
    assert plan.verdict is Verdict.VERIFIED
    marginal = marginalise(posterior.parameters, posterior.measurements)
    threshold = problem.stations[0].threshold_dbm
    chance = marginal.connectivity(plan.positions_m[1:], threshold)
    assert chance.min() >= 0.92 - 1e-7
    assert chance.min() < 0.925
    simulate(problem, seed=SEED).save(tmp_path)
    assert check(tmp_path).reasons == ()


def test_what_is_possible_is_asked_of_the_mixture():
    """A step that is missed is excused by margins of the same law that it is missed by."""
    problem = all_uncertain(terms_problem(TRACKING, p_min=0.9))
    problem = replace(problem, robots=(replace(problem.robots[0], start_m=(37.0, 37.0)),))
    solution = solve(problem, seed=SEED)
    plan, posterior = solution.plans[0], solution.belief.posterior
    law = uncertain_law(problem, [posterior])
    assert law is not None
    certificate = plan.certificate
    assert certificate.relaxed_steps[0] == 1
    start = np.array([37.0, 37.0])
    grid = np.stack(np.meshgrid(*[np.linspace(-2.0, 2.0, 81)] * 2), axis=-1).reshape(-1, 2)
    places = start + grid[np.hypot(*grid.T) <= problem.step_length_m]
    power = law.power(places)
    margin = bound_margin_db(
        power.mean_db, power.deviation_db, problem.stations[0].threshold_dbm, 0.9
    )
    assert certificate.best_margin_db[0] == pytest.approx(margin.max(), abs=0.02)
