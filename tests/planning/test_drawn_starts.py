"""Starts drawn with the seed, targets that stay free, and parameters that are not estimated."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from planopt import InputError, check, load, simulate, solve
from planopt.channel import condition
from planopt.planning.free_space import with_drawn_starts
from planopt.planning.initial_data import prepare
from planopt.problems import (
    GivenParameters,
    SampledMeasurements,
    problem_from_dict,
    problem_to_dict,
)
from planopt.problems.load import check_files

SEEDS = range(60)


@pytest.fixture(scope="module")
def fig4():
    problem = load("fig4")
    return replace(problem, planner=replace(problem.planner, max_steps=4, horizon=2))


def test_robots_start_uniformly_in_their_disc(fig4):
    """The mean squared distance from its middle is half the squared radius; none is nearer than."""
    drawn = [with_drawn_starts(fig4, seed) for seed in SEEDS]
    places = np.array([[robot.start_m for robot in each.robots] for each in drawn])
    away = np.linalg.norm(places - [24.0, 24.0], axis=2)
    assert away.max() <= 15.0
    # The variance of r^2 / R^2, uniform on [0, 1], is 1 / 12.
    share = (away / 15.0) ** 2
    assert share.mean() == pytest.approx(0.5, abs=4.0 / np.sqrt(12.0 * share.size))
    assert all(robot.start_spread_m == 0.0 for each in drawn for robot in each.robots)


def test_targets_start_at_their_distance_and_move_away():
    """6 m from the station at 1.1 m/s, heading away within 0.35 rad, and free to the end."""
    problem = load("fig4")
    for seed in range(20):
        (target,) = with_drawn_starts(problem, seed).targets
        away, velocity = np.array(target.start_m) - 24.0, np.array(target.velocity_m_s)
        assert np.linalg.norm(away) == pytest.approx(6.0)
        assert np.linalg.norm(velocity) == pytest.approx(1.1)
        assert away @ velocity >= 6.0 * 1.1 * np.cos(0.35) - 1e-9


def test_same_seed_same_starts_and_other_streams_stay(fig4):
    """Another seed, others; what is measured is that of a problem that draws no starts."""
    assert with_drawn_starts(fig4, 3) == with_drawn_starts(fig4, 3)
    assert with_drawn_starts(fig4, 3).robots != with_drawn_starts(fig4, 4).robots
    fixed = with_drawn_starts(fig4, 3)
    assert with_drawn_starts(fixed, 9) is fixed
    one, other = prepare(fig4, 3), prepare(fixed, 3)
    measured = (each.belief.posterior.measurements.power_dbm for each in (one, other))
    assert np.array_equal(*measured)


def test_starts_are_clear_and_apart(fig4):
    """Also where the disc reaches over an obstacle and robots have to keep 6 m apart."""
    robots = tuple(replace(robot, start_m=(36.0, 46.0)) for robot in fig4.robots)
    apart = replace(fig4.constraints, separation_m=6.0)
    crowded = replace(fig4, robots=robots, constraints=apart)
    blocks = shapely.union_all([each.polygon for each in fig4.workspace.obstacles])
    for seed in range(20):
        places = np.array([each.start_m for each in with_drawn_starts(crowded, seed).robots])
        assert shapely.distance(blocks, shapely.points(places)).min() >= 0.5
        gaps = np.linalg.norm(places[:, None] - places, axis=2)[np.triu_indices(3, 1)]
        assert gaps.min() >= 6.0


def test_what_cannot_be_drawn_is_refused(fig4):
    """No room for three robots that far apart; a target too fast to stay."""
    far = replace(fig4, constraints=replace(fig4.constraints, separation_m=40.0))
    with pytest.raises(InputError, match="no free start position") as error:
        with_drawn_starts(far, 0)
    assert error.value.key is not None and error.value.key.endswith("start_spread_m")
    fast = replace(fig4, targets=(replace(fig4.targets[0], velocity_m_s=(60.0, 0.0)),))
    with pytest.raises(InputError, match="no straight target path"):
        solve(fast)
    fixed = replace(fig4.targets[0], start_m=(1.0, 1.0), velocity_m_s=(-9.0, 0.0))
    gone = replace(fig4, targets=(replace(fixed, start_distance_m=None),))
    with pytest.raises(InputError, match="stays within") as error:
        solve(gone)
    assert error.value.key == "targets[0].stays_free"


def test_drawn_starts_are_not_for_a_way_to_a_goal():
    """Nor for robots that cannot stop at will."""
    for name in ("open_field", "harbour_track"):
        problem = load(name)
        robots = (replace(problem.robots[0], start_spread_m=1.0), *problem.robots[1:])
        with pytest.raises(InputError) as error:
            problem_from_dict(problem_to_dict(replace(problem, robots=robots)))
        assert error.value.key == "robots[0].start_spread_m"


def test_a_run_with_drawn_starts_is_saved_as_driven(fig4, tmp_path):
    """The check draws the same starts, and has nothing to remark of them."""
    run = simulate(fig4, seed=5)
    assert run.problem.robots == with_drawn_starts(fig4, 5).robots
    run.save(tmp_path / "run")
    found = check(tmp_path / "run")
    assert found.verdict.value == "verified"
    assert not [words for words in found.remarks if "robots" in words]
    # Path loss is known: nothing is left of its covariance to take a logarithm of.
    assert np.isnan(run.metrics["trace_m_db"]) and np.isnan(run.metrics["log_det_m"])


def test_parameters_given_are_not_estimated(fig4):
    """The posterior is that of the parameters; without path loss it is that of its estimate."""
    given = fig4.channel.given
    belief = prepare(fig4, 0).belief
    assert belief.fit.method == "given" and belief.posterior.theta_known
    parameters, measured = belief.fit.parameters, belief.posterior.measurements
    assert (parameters.k_pl_db, parameters.n_pl) == (-10.0, 2.0)
    places = np.array([[30.0, 40.0], [60.0, 10.0]])
    known = condition(parameters, measured, theta="known").predict(places)
    assert np.array_equal(known.mean_db, belief.posterior.predict(places).mean_db)

    def fitted(given):
        return prepare(replace(fig4, channel=replace(fig4.channel, given=given)), 0).belief

    half = fitted(replace(given, k_pl_db=None, n_pl=None))
    estimate = condition(parameters, measured)
    assert half.posterior.theta == pytest.approx(estimate.theta)
    assert half.fit.standard_errors["n_pl"] == pytest.approx(
        np.sqrt(estimate.theta_covariance[1, 1])
    )
    assert half.fit.standard_errors["decorrelation_m"] == 0.0
    with pytest.raises(InputError, match="one of k_pl_db and n_pl"):
        GivenParameters(shadow_std_db=4.0, decorrelation_m=20.0, multipath_std_db=1.0, n_pl=2.0)


def test_without_a_first_measurement(fig4, tmp_path):
    """All parameters given, nothing measured: the first prediction is path loss alone."""
    channel = replace(fig4.channel, measurements=SampledMeasurements(0))
    run = simulate(replace(fig4, channel=channel), seed=1)
    assert run.first_measurements == 0 and run.verified_rate == 1.0
    run.save(tmp_path / "run")
    assert check(tmp_path / "run").verdict.value == "verified"
    check_files(replace(fig4, channel=channel))
    unknown = replace(fig4, channel=replace(channel, given=None))
    with pytest.raises(InputError, match="no initial measurements"):
        simulate(unknown, seed=1)
    with pytest.raises(InputError, match=r"or all parameters in channel\.fit\.given"):
        check_files(unknown)
