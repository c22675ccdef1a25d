"""Learning path loss: batch = sequential = re-estimation, equations 1.10 and 4.1, invariances."""

import dataclasses

import numpy as np
import pytest
from path_scene import CHANNEL, NOTHING, PATH, drawn, measured_at, moved

from planopt.channel.kriging import kriging_terms
from planopt.channel.measurement_covariance import shadow_covariance_db2
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import Station, regressors
from planopt.channel.posterior import WEAK_THETA_DEVIATION, condition, extend
from planopt.errors import InputError
from planopt.objectives.path_loss_learning import (
    Criterion,
    goal_criterion,
    path_loss_one_step,
    path_loss_steps,
    path_loss_value,
    theta_information,
)

DATA = drawn(12)
POSTERIOR = condition(CHANNEL, DATA)
GOALS = np.array([[5.0, 50.0], [40.0, 8.0], [55.0, 55.0]])
WEIGHT = np.array([1.0, 0.5, 2.0])
GOAL = goal_criterion(POSTERIOR, GOALS, WEIGHT)
CRITERIA = [Criterion("T"), Criterion("D"), Criterion("A"), GOAL]


def information_after(measurements):
    """M^-1 = Gamma' U^-1 Gamma from nothing but the definition."""
    u = shadow_covariance_db2(measurements.positions_m, measurements.positions_m, CHANNEL)
    u += CHANNEL.multipath_std_db**2 * np.eye(len(measurements))
    gamma = regressors(measurements.positions_m, CHANNEL.station)
    return gamma.T @ np.linalg.solve(u, gamma)


def worth(information, kind, goal=None):
    """A criterion, written out."""
    if kind == "D":
        return np.log(np.linalg.det(information))
    return -np.trace((np.eye(2) if kind == "A" else goal) @ np.linalg.inv(information))


def test_batch_equals_direct_recomputation():
    """Every criterion from the information of all measurements, path included; 1e-10."""
    after = information_after(
        Measurements(
            np.vstack([DATA.positions_m, PATH]),
            np.zeros(17),
            np.zeros(17, dtype=bool),
        )
    )
    gained = np.trace(after - information_after(DATA))
    assert path_loss_value(POSTERIOR, PATH, Criterion("T")) == pytest.approx(gained, rel=1e-10)
    for criterion in CRITERIA[1:]:
        assert path_loss_value(POSTERIOR, PATH, criterion) == pytest.approx(
            worth(after, criterion.kind, criterion.goal), rel=1e-10
        )


def test_batch_equals_the_extended_posterior():
    """The posterior after the path has the covariance that the plan foretold."""
    after = extend(POSTERIOR, measured_at(PATH))
    expected = np.linalg.slogdet(after.theta_covariance)[1]
    assert path_loss_value(POSTERIOR, PATH, Criterion()) == pytest.approx(-expected, rel=1e-10)


def test_batch_equals_the_sum_over_steps():
    """T: |varphi|^2 / sigma^2 of each step, the earlier ones measured; 1e-10."""
    now, each = POSTERIOR, []
    for place in PATH:
        each.append(path_loss_one_step(now, place[None], Criterion("T"))[0])
        now = extend(now, measured_at(place[None]))
    np.testing.assert_allclose(path_loss_steps(POSTERIOR, PATH), each, rtol=1e-10)
    assert path_loss_value(POSTERIOR, PATH, Criterion("T")) == pytest.approx(sum(each), rel=1e-10)


def test_one_step_is_the_seeds_equation_2():
    """J_PL = |gamma - Gamma' U^-1 phi|^2 / sigma^2 (equation 4.1), by dense inverses."""
    u = shadow_covariance_db2(DATA.positions_m, DATA.positions_m, CHANNEL) + 4.0 * np.eye(12)
    phi = shadow_covariance_db2(DATA.positions_m, PATH, CHANNEL)
    solved = np.linalg.solve(u, phi)
    varphi = regressors(PATH, CHANNEL.station) - solved.T @ regressors(
        DATA.positions_m, CHANNEL.station
    )
    sigma2 = 25.0 + 4.0 - (phi * solved).sum(axis=0)
    expected = (varphi**2).sum(axis=1) / sigma2
    np.testing.assert_allclose(
        path_loss_one_step(POSTERIOR, PATH, Criterion("T")), expected, rtol=1e-10
    )
    for place, one in zip(PATH, expected, strict=True):
        value = path_loss_value(POSTERIOR, place[None], Criterion("T"))
        assert value == pytest.approx(one, rel=1e-10)


def test_one_step_is_the_recursion_1():
    """D and A of one step by the rank-one update; together and one by one."""
    terms = kriging_terms(POSTERIOR, PATH)
    m = POSTERIOR.theta_covariance
    mv = terms.trend @ m
    ratio = (mv * terms.trend).sum(axis=1) / terms.variance_db2
    before = worth(np.linalg.inv(m), "D")
    found = path_loss_one_step(POSTERIOR, PATH, Criterion("D"))
    np.testing.assert_allclose(found, before + np.log1p(ratio), rtol=1e-10)
    less = (mv**2).sum(axis=1) / (terms.variance_db2 * (1.0 + ratio))
    found = path_loss_one_step(POSTERIOR, PATH, Criterion("A"))
    np.testing.assert_allclose(found, -np.trace(m) + less, rtol=1e-10)
    for criterion in CRITERIA:
        each = [path_loss_value(POSTERIOR, place[None], criterion) for place in PATH]
        np.testing.assert_allclose(path_loss_one_step(POSTERIOR, PATH, criterion), each, rtol=1e-10)


@pytest.mark.parametrize("criterion", CRITERIA, ids=lambda each: each.kind)
def test_more_measurements_are_never_worth_less(criterion):
    """Value grows along every path and is at least that of no path."""
    values = [path_loss_value(POSTERIOR, PATH[:k], criterion) for k in range(1, 6)]
    assert (np.diff(values) >= -1e-12).all()
    nothing = (
        0.0
        if criterion.kind == "T"
        else worth(theta_information(POSTERIOR), criterion.kind, criterion.goal)
    )
    assert values[0] >= nothing


@pytest.mark.parametrize("count", [0, 1])
def test_the_weak_prior_is_part_of_the_plan(count):
    """Below two measurements M has the weak prior; the plan keeps it, estimation drops it."""
    posterior = condition(CHANNEL, drawn(count) if count else NOTHING)
    weak = np.diag(1.0 / np.array(WEAK_THETA_DEVIATION) ** 2)
    after = extend(posterior, measured_at(PATH))
    expected = np.linalg.inv(after.theta_covariance) + weak
    for kind in ("D", "A"):
        found = path_loss_value(posterior, PATH, Criterion(kind))
        assert found == pytest.approx(worth(expected, kind), rel=1e-9)
    assert np.isfinite(path_loss_value(posterior, PATH, Criterion("T")))


def test_v_prefers_what_d_does_not_ask_for():
    """With a goal far out, V values the path by the variance theta has there."""
    after = extend(POSTERIOR, measured_at(PATH)).theta_covariance
    varphi = kriging_terms(POSTERIOR, GOALS).trend
    expected = -(WEIGHT * np.einsum("gi,ij,gj->g", varphi, after, varphi)).sum()
    assert path_loss_value(POSTERIOR, PATH, GOAL) == pytest.approx(expected, rel=1e-10)


def test_the_order_of_measurements_and_of_the_path_does_not_matter():
    """Information is added, whatever comes first."""
    shuffled = condition(CHANNEL, DATA.take(np.random.default_rng(0).permutation(12)))
    for criterion in CRITERIA:
        expected = path_loss_value(POSTERIOR, PATH, criterion)
        assert path_loss_value(shuffled, PATH, criterion) == pytest.approx(expected, rel=1e-9)
        assert path_loss_value(POSTERIOR, PATH[::-1], criterion) == pytest.approx(
            expected, rel=1e-9
        )


@pytest.mark.parametrize("scale", [1.0, 1000.0])
@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_moving_the_scene_changes_nothing_and_units_only_what_they_must(mirror, scale):
    """Turned, mirrored, shifted: all as before. In another unit: D and V as before, A and T not.

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
    path, goals = (scale * places @ turn.T + shift for places in (PATH, GOALS))
    for before in CRITERIA:
        kind = before.kind
        after = goal_criterion(posterior, goals, WEIGHT) if kind == "V" else before
        same = path_loss_value(posterior, path, after) == pytest.approx(
            path_loss_value(POSTERIOR, PATH, before), rel=1e-8
        )
        assert same == (scale == 1.0 or kind in ("D", "V")), kind


def test_known_theta_teaches_nothing():
    """D, A and V are refused with the reason; T needs no M and stays."""
    known = condition(CHANNEL, DATA, theta="known")
    assert path_loss_value(known, PATH, Criterion("T")) == pytest.approx(
        path_loss_value(POSTERIOR, PATH, Criterion("T")), rel=1e-12
    )
    for criterion in CRITERIA[1:]:
        with pytest.raises(InputError, match="known"):
            path_loss_value(known, PATH, criterion)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Criterion("E"),
        lambda: Criterion("V", np.eye(3)),
        lambda: goal_criterion(POSTERIOR, GOALS, np.ones(2)),
        lambda: goal_criterion(POSTERIOR, GOALS, -WEIGHT),
        lambda: goal_criterion(POSTERIOR, GOALS * np.nan, WEIGHT),
        lambda: path_loss_value(POSTERIOR, np.zeros((0, 2)), Criterion()),
    ],
)
def test_bad_input_is_ours(make):
    """Every check raises InputError."""
    with pytest.raises(InputError):
        make()
