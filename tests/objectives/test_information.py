"""What measurements will tell: definitions, re-conditioning, invariances, derivatives, gates."""

import dataclasses

import numpy as np
import pytest
from path_scene import (
    CHANNEL,
    NOTHING,
    PATH,
    START,
    drawn,
    measured_at,
    moved,
    partly_open,
    power_at,
)
from refusals import refused

from planopt import InputError, Measurements
from planopt.channel import Station, condition, joint_prediction
from planopt.channel.kriging import LocalChannel, LocalGrid, kriging_terms, predict
from planopt.channel.measurements import shadow_covariance_db2
from planopt.channel.parameters import regressors
from planopt.channel.posterior import WEAK_THETA_DEVIATION, extend, factored_near
from planopt.objectives.information import (
    Information,
    PathUncertainty,
    VarianceRemoved,
    map_criterion,
    square_root,
)
from planopt.objectives.measuring import MeasuringRule
from planopt.objectives.moments import (
    Region,
    covariance_factor,
    cross_covariance_db2,
    known_places,
    posterior_moments,
)
from planopt.objectives.path_derivatives import LocalPaths, by_positions
from planopt.objectives.stage_power import CUSP_ROUNDING, fill_rounded_kernel, softened_m2

DATA = drawn(15)
POSTERIOR = condition(CHANNEL, DATA)
KNOWN = condition(CHANNEL, DATA, theta="known")
GRID = np.random.default_rng(4).uniform(0.0, 60.0, (30, 2))
REGION = Region(GRID, np.linspace(0.5, 1.5, 30) / 30.0)
# A path that stands still, comes back, and crosses a measured place.
AWKWARD = np.vstack([PATH[:2], PATH[1], DATA.positions_m[3], PATH[0]])
JOINED = np.cumsum(np.linalg.norm(np.diff(np.vstack([START, PATH]), axis=0), axis=1))


def gain_of(name, posterior, region=REGION, start=START, per_m=1.0):
    spread = posterior.theta_covariance
    match name:
        case "T":
            return VarianceRemoved(np.eye(2), universal=False)
        case "D":
            return Information("path loss", 2.0)
        case "A":
            return VarianceRemoved(spread)
        case "V":
            return VarianceRemoved(spread @ square_root(map_criterion(posterior, region)))
        case "information":
            return Information()
        case "average":
            return VarianceRemoved()
    threshold = {"path": 8.0, "near the threshold": 25.0, "no threshold": 0.0}[name]
    return PathUncertainty(start, threshold, 0.02 * per_m if threshold else 0.0)


LEARNING, MAPPING = ("T", "D", "A", "V"), ("information", "average", "path")
GAINS = (*LEARNING, *MAPPING, "near the threshold", "no threshold")


def exact(name, posterior=POSTERIOR, path=PATH, region=REGION, **settings):
    moments = posterior_moments(posterior, path, region=region)
    return float(gain_of(name, posterior, region, **settings).value(moments))


def theta_covariance_after(places):
    """(Gamma' U^-1 Gamma)^-1 of all measurements, from nothing but the definition."""
    u = shadow_covariance_db2(places, places, CHANNEL) + 4.0 * np.eye(len(places))
    gamma = regressors(places, CHANNEL.station)
    return np.linalg.inv(gamma.T @ np.linalg.solve(u, gamma))


@pytest.mark.parametrize("name", LEARNING)
def test_learning_is_direct_recomputation(name):
    """Every criterion from the covariance of theta by all measurements, path included; 1e-9."""
    before = theta_covariance_after(DATA.positions_m)
    after = theta_covariance_after(np.vstack([DATA.positions_m, PATH]))
    varphi = kriging_terms(POSTERIOR, GRID).trend
    goal = varphi.T @ (REGION.weight[:, None] * varphi)
    expected = {
        "T": np.trace(np.linalg.inv(after) - np.linalg.inv(before)),
        "D": np.log(np.linalg.det(before) / np.linalg.det(after)),
        "A": np.trace(before - after),
        "V": np.trace(goal @ (before - after)),
    }
    assert exact(name) == pytest.approx(expected[name], rel=1e-9)


@pytest.mark.parametrize("count", [0, 1])
def test_the_weak_prior_is_part_of_the_plan(count):
    """Below two measurements M has the weak prior; the plan keeps it, estimation drops it."""
    posterior = condition(CHANNEL, drawn(count) if count else NOTHING)
    weak = np.diag(1.0 / np.array(WEAK_THETA_DEVIATION) ** 2)
    after = extend(posterior, measured_at(PATH)).theta_covariance
    after, before = np.linalg.inv(np.linalg.inv(after) + weak), posterior.theta_covariance
    expected = np.log(np.linalg.det(before) / np.linalg.det(after))
    assert exact("D", posterior) == pytest.approx(expected, rel=1e-8)
    assert exact("A", posterior) == pytest.approx(np.trace(before - after), rel=1e-8)


def step_variances(posterior):
    """Variance at each place of the path once the earlier ones are measured."""
    found = []
    for place in PATH:
        found.append(predict(posterior, place[None]).deviation_db[0] ** 2)
        posterior = extend(posterior, measured_at(place[None]))
    return np.array(found)


@pytest.mark.parametrize("posterior", [POSTERIOR, KNOWN], ids=["estimated", "known"])
def test_mapping_is_conditioning_place_after_place(posterior):
    """Information and path form by variances, the average by predicting again; 1e-9."""
    variance = step_variances(posterior)
    information = 0.5 * np.log(variance / 4.0).sum()
    assert exact("information", posterior) == pytest.approx(information, rel=1e-10)
    above = (np.maximum(0.0, variance - 8.0) * np.exp(-0.02 * JOINED)).sum()
    assert exact("path", posterior) == pytest.approx(above, rel=1e-10)
    after = extend(posterior, measured_at(PATH))
    less = predict(posterior, GRID).deviation_db ** 2 - predict(after, GRID).deviation_db ** 2
    assert exact("average", posterior) == pytest.approx(float(REGION.weight @ less), rel=1e-9)


@pytest.mark.parametrize("name", [*LEARNING, *MAPPING])
def test_more_measurements_never_lower_information(name):
    """Values grow along every path; information on the channel is submodular."""
    values = [exact(name, path=PATH[:k]) for k in range(1, 6)]
    assert values[0] >= 0.0 and (np.diff(values) >= -1e-12).all()
    if name == "information":
        last = PATH[4:]
        gains = [exact(name, path=np.vstack([PATH[:k], last])) - values[k - 1] for k in range(1, 5)]
        assert (np.diff(gains) <= 1e-12).all()


def test_the_claimed_variance_is_the_simulated_error():
    """Universal kriging after the path: squared errors of 4,000 channels within 5 errors."""
    data, goal = DATA.positions_m[:8], np.array([[20.0, 16.0]])
    few = condition(CHANNEL, DATA.take(slice(8)))
    before = predict(few, goal).deviation_db[0] ** 2
    claimed = before - exact("average", few, region=Region(goal, np.ones(1)))
    places = np.vstack([data, PATH, goal])

    def predicted(power):
        seen = Measurements(places[:-1], power, np.zeros(13, dtype=bool))
        return predict(condition(CHANNEL, seen), goal).mean_db[0]

    # The prediction is linear in the measurements, so that thirteen of them give it.
    weights = np.array([predicted(unit) for unit in np.eye(13)]) - predicted(np.zeros(13))
    power = power_at(places, CHANNEL, np.random.default_rng(0), 4000)
    errors = power[:, -1] - power[:, :-1] @ weights - predicted(np.zeros(13))
    assert abs((errors**2).mean() - claimed) < 5.0 * claimed * np.sqrt(2.0 / 4000)
    assert claimed < 0.7 * before


@pytest.mark.parametrize("scale", [1.0, 1000.0])
@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("name", [*LEARNING, *MAPPING])
def test_moving_the_scene_changes_nothing_and_units_only_what_they_must(name, mirror, scale):
    """Turned, mirrored, shifted: all as before. In another unit all but A and T.

    Kilometres read as if they were metres; the other way round distances would be below the least.
    """
    turn, shift = np.array([[0.6, -0.8 * mirror], [0.8, 0.6 * mirror]]), 7.0
    x, y = scale * turn @ np.array(CHANNEL.station.position_m) + shift
    other = dataclasses.replace(
        CHANNEL,
        decorrelation_m=scale * CHANNEL.decorrelation_m,
        station=Station((x, y), scale * CHANNEL.station.height_m),
    )
    posterior = condition(other, moved(DATA, turn, shift, scale))
    path, grid = (scale * places @ turn.T + shift for places in (PATH, GRID))
    region, start = Region(grid, REGION.weight), tuple(scale * turn @ np.array(START) + shift)
    found = exact(name, posterior, path, region, start=start, per_m=1.0 / scale)
    same = found == pytest.approx(exact(name), rel=1e-8)
    assert same == (scale == 1.0 or name not in ("A", "T"))


def test_without_multipath_information_is_refused():
    """And a path that comes twice to a place."""
    dry = condition(dataclasses.replace(CHANNEL, multipath_std_db=0.0), NOTHING, theta="known")
    with refused():
        exact("information", dry)
    with refused():
        covariance_factor(posterior_moments(dry, PATH[[0, 0]]).covariance)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Region(GRID, np.ones(3)),
        lambda: Region(GRID[:, :1], np.ones(30)),
        lambda: Region(GRID, np.full(30, np.nan)),
        lambda: exact("information", path=PATH * np.nan),
        lambda: exact("path", path=PATH[:, :1]),
        lambda: exact("D", path=np.zeros((0, 2))),
    ],
)
def test_bad_input_is_ours(make):
    with pytest.raises(InputError):
        make()


def test_cross_covariance_is_a_block_of_the_joint_one():
    whole = joint_prediction(POSTERIOR, np.vstack([PATH, GRID])).covariance_db2
    found = cross_covariance_db2(POSTERIOR, PATH, known_places(POSTERIOR, GRID))
    np.testing.assert_allclose(found, whole[:5, 5:], atol=1e-10)


def test_without_a_factor_the_near_measurements_serve():
    """512 of 900 and more, theta and its covariance those of all; values within 0.5 %."""
    data = drawn(900, side_m=150.0)
    whole, many = condition(CHANNEL, data), condition(CHANNEL, data, exact_limit=100)
    near = factored_near(many, PATH)
    assert factored_near(whole, PATH) is whole and not many.has_factor
    assert near.has_factor and 512 <= len(near.measurements) < 900
    np.testing.assert_array_equal(near.theta_covariance, many.theta_covariance)
    for name in ("T", "D", "information", "average"):
        assert exact(name, many) == pytest.approx(exact(name, whole), rel=5e-3)


# Local channels: values of many paths, and derivatives of one.


def local(name, path, posterior=POSTERIOR, count=15, rule=None):
    """Value and derivatives of one path from the measurements near `PATH`."""
    channel = LocalChannel.around(posterior, PATH, count)
    gates = None if rule is None else rule.gates(path[None])
    grid = LocalGrid.of(channel, GRID, REGION.weight)
    near = LocalPaths(channel, path[None], None if gates is None else gates.value, grid)
    return by_positions(gain_of(name, posterior).derivatives(near), gates)


def of_many(paths, gate=None, order=0):
    """Many paths by one local channel."""
    channel = LocalChannel.around(POSTERIOR, PATH, 15)
    grid = LocalGrid.of(channel, GRID, REGION.weight)
    return LocalPaths(channel, paths, gate, grid, order)


def require_derivatives(evaluate, path, rtol):
    """Gradient from values and Hessian from gradients, relative to the largest; symmetric."""
    found, h = evaluate(path), 1e-5
    gradient, hessian = np.empty(path.size), np.empty((path.size, path.size))
    for p in range(path.size):
        step = h * np.eye(path.size)[p].reshape(path.shape)
        more, less = evaluate(path + step), evaluate(path - step)
        gradient[p] = (more.value - less.value) / (2 * h)
        hessian[p] = (more.gradient - less.gradient) / (2 * h)
    # Rounding of the values limits what differences of them can show.
    noise = 1e-14 * max(1.0, abs(found.value)) / h
    largest = np.abs(hessian).max()
    np.testing.assert_allclose(found.gradient, gradient, atol=1e-6 * np.abs(gradient).max() + noise)
    np.testing.assert_allclose(found.hessian, hessian, atol=rtol * largest)
    np.testing.assert_allclose(found.hessian, found.hessian.T, atol=1e-9 * largest)


@pytest.mark.parametrize("path", [PATH, PATH[:1], AWKWARD], ids=["path", "one step", "awkward"])
@pytest.mark.parametrize("name", GAINS)
def test_derivatives_are_those_of_central_differences(name, path):
    """Within the roundings third derivatives are large: 1e-10 / eps^2 of the Hessian."""
    require_derivatives(lambda at: local(name, at), path, 2e-6)


@pytest.mark.parametrize("count", [0, 1, 12])
@pytest.mark.parametrize("name", GAINS)
def test_with_tiny_roundings_the_value_is_exact(name, count, monkeypatch):
    """All measurements used and roundings a billionth: the objective itself, to 1e-7."""
    monkeypatch.setattr("planopt.objectives.stage_power.CUSP_ROUNDING", 1e-9)
    monkeypatch.setattr("planopt.objectives.stage_power.MIN_DISTANCE_M", 0.0)
    monkeypatch.setattr("planopt.objectives.information.CUSP_ROUNDING", 1e-9)
    monkeypatch.setattr("planopt.objectives.information.THRESHOLD_ROUNDING", 1e-9)
    posterior = condition(CHANNEL, drawn(count) if count else NOTHING)
    found = local(name, PATH, posterior, max(count, 1)).value
    assert found == pytest.approx(exact(name, posterior), rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("name", GAINS)
def test_roundings_cost_little_and_single_precision_less(name):
    """Within 1.2 % of the exact value for one path, and 1e-4 for many; gates leave places out."""
    value = exact(name)
    # The threshold's rounding adds at most 3/16 of its width, 0.01 * 29 dB^2, a step.
    stated = 0.0 if name in (*LEARNING, "information", "average") else 5.0 * 3.0 / 16.0 * 0.29
    assert abs(local(name, PATH).value - value) < 0.012 * abs(value) + stated
    paths, gain = np.stack([PATH, PATH + 3.0]), gain_of(name, POSTERIOR)
    assert gain.value(of_many(paths).moments)[0] == pytest.approx(value, rel=1e-4)
    taken = np.array([True, True, True, False, False])
    some = float(gain.value(posterior_moments(POSTERIOR, PATH, taken, REGION)))
    assert some == pytest.approx(exact(name, path=PATH[:3]), rel=1e-9)
    gate = np.stack([taken, taken]).astype(float)
    found = gain.value(of_many(paths, gate).moments)[0]
    assert found == pytest.approx(some, rel=1e-4)


@pytest.mark.parametrize("name", ["T", "D", "A", *MAPPING])
def test_gradients_of_ranked_paths_are_those_of_single_ones(name):
    """In single precision, and without the roundings that solvers need."""
    gate = np.array([[1.0, 0.7, 1.0, 0.3, 1.0]])
    many, one = (of_many(PATH[None], gate, order) for order in (1, 2))
    found, expected = (gain_of(name, POSTERIOR).slope(each) for each in (many, one))
    np.testing.assert_allclose(found, expected, atol=0.03 * np.abs(expected).max())


SPACING_M = 2.0
CLOSE = condition(CHANNEL, drawn(30, side_m=20.0))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["T", "D", "A", *MAPPING])
def test_gated_gains_have_the_derivatives_of_their_values(name, seed):
    rule, path, _ = partly_open(seed)
    require_derivatives(lambda at: local(name, at, CLOSE, 30, rule), path, 5e-6)


@pytest.mark.parametrize("name", ["T", "D", "A", *MAPPING])
def test_closed_places_are_left_out_and_open_ones_counted_whole(name):
    """Gates of 0 and 1: the gain of the places that are measured, nothing else."""
    path = np.array([[4.0, 5.0], [8.0, 5.0], [8.0, 5.5], [12.0, 9.0], [4.5, 5.0]])
    rule = MeasuringRule(SPACING_M, (np.array([[12.0, 10.0]]),))
    np.testing.assert_array_equal(rule.gates(path[None]).value[0], [1.0, 1.0, 0.0, 0.0, 0.0])
    found, alone = local(name, path, CLOSE, 30, rule), local(name, path[:2], CLOSE, 30)
    # The threshold's rounding gives 3/16 of its width for each place without a measurement, a
    # little more nearby, so that such places have a slope all the same.
    stated = 3 * 3.0 / 16.0 * 0.29 if name == "path" else 1e-9 * abs(alone.value)
    assert found.value == pytest.approx(alone.value, abs=stated)
    near = (3e-2 if name == "path" else 1e-9) * np.abs(alone.gradient).max()
    np.testing.assert_allclose(found.gradient[:4], alone.gradient, atol=near)
    np.testing.assert_allclose(found.gradient[4:], 0.0, atol=near)


def test_rounding_costs_what_is_said():
    """At most the share eps / beta at the cusp; at ten roundings a twentieth of it."""
    away = CUSP_ROUNDING * CHANNEL.decorrelation_m * np.array([0.0, 10.0, 100.0])
    places = np.column_stack([away, np.zeros(3)])
    exact = shadow_covariance_db2(places, np.zeros((1, 2)), CHANNEL)[:, 0]
    rows = np.empty((1, 3))
    fill_rounded_kernel(rows, *places.T, CHANNEL, softened_m2(0.0, CHANNEL))
    less = 1.0 - rows[0] / exact
    assert (less > 0.0).all() and less[0] <= CUSP_ROUNDING
    assert less[0] == pytest.approx(CUSP_ROUNDING, rel=0.01)
    assert less[1] <= CUSP_ROUNDING / 20.0
