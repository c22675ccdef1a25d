"""A comparison: complete, paired, and the same however many processes made it."""

from dataclasses import fields, replace
from itertools import product

import numpy as np
import pytest
import scipy.stats
from refusals import refused

from planopt import Comparison, InputError, compare, load
from planopt.planning.loop.log import Metrics, Outcome
from planopt.planning.loop.metrics import COSTS as COST_METRICS
from planopt.planning.loop.results import summary_of
from planopt.planning.solve import simulate
from planopt.studies.comparison import Row, log_ratios, mean_interval, tabulate

HORIZONS, COSTS, SEEDS = (1, 6), ("geodesic", "connected"), 6
TIMES = {"p50_step_s", "p95_step_s"}
METRICS = [*(field.name for field in fields(Metrics)), *COST_METRICS]


@pytest.fixture(scope="module")
def problem():
    """A corner of the open field, some ten steps wide; the limit cuts some loops short."""
    whole = load("open_field")
    robot = replace(whole.robots[0], start_m=(70.0, 60.0))
    return replace(whole, robots=(robot,), planner=replace(whole.planner, max_steps=9))


@pytest.fixture(scope="module")
def seen() -> list:
    """Runs in the order in which they were reported."""
    return []


@pytest.fixture(scope="module")
def comparison(problem, seen) -> Comparison:
    return compare(problem, HORIZONS, costs_to_go=COSTS, seeds=SEEDS, on_run=seen.append)


def rows_of(comparison: Comparison, horizon: int, cost_to_go: str) -> dict[str, Row]:
    return {
        row.metric: row
        for row in comparison.rows
        if (row.horizon, row.cost_to_go) == (horizon, cost_to_go)
    }


def runs_of(comparison: Comparison, horizon: int, cost_to_go: str) -> list:
    return [
        run for run in comparison.runs if (run.horizon, run.cost_to_go) == (horizon, cost_to_go)
    ]


def test_every_setting_on_every_seed(comparison, seen):
    """Setting by setting, seed by seed, each reported once."""
    assert [(r.cost_to_go, r.horizon, r.seed) for r in comparison.runs] == list(
        product(COSTS, HORIZONS, range(SEEDS))
    )
    assert [(r.seed, r.cost_to_go, r.horizon) for r in seen] == list(
        product(range(SEEDS), COSTS, HORIZONS)
    )
    assert {id(run) for run in seen} == {id(run) for run in comparison.runs}
    assert comparison.wall_s > 0.0


def test_every_metric_of_every_setting(comparison, problem):
    """A row each, with the counts of its runs."""
    assert [(r.cost_to_go, r.horizon, r.metric) for r in comparison.rows] == list(
        product(COSTS, HORIZONS, METRICS)
    )
    assert comparison.problem is problem
    for row in comparison.rows:
        runs = runs_of(comparison, row.horizon, row.cost_to_go)
        assert row.seeds == SEEDS
        assert row.planner == "auto"
        assert row.stalled == sum(run.outcome != Outcome.REACHED for run in runs)
        released = sum(sum(run.rungs.values()) for run in runs)
        verified = sum(run.verified_rate * len(run.step_s) for run in runs)
        assert row.verified_rate == pytest.approx(verified / released)
        steps = np.concatenate([run.step_s for run in runs])
        assert row.p50_step_s == np.median(steps)
        assert row.p95_step_s == np.quantile(steps, 0.95)


def test_means_and_intervals_against_scipy(comparison):
    """Student's interval over the runs for which the metric exists."""
    compared = 0
    for row in comparison.rows:
        runs = runs_of(comparison, row.horizon, row.cost_to_go)
        values = np.array([run.metrics[row.metric] for run in runs])
        values = values[np.isfinite(values)]
        assert row.count == len(values)
        if len(values) == 0:
            assert row.mean is row.ci_low is row.ci_high is None
            continue
        assert row.mean == pytest.approx(values.mean())
        if len(values) < 5:
            assert row.ci_low is row.ci_high is None
            continue
        if values.std() == 0.0:
            continue
        low, high = scipy.stats.t.interval(
            0.95, len(values) - 1, values.mean(), scipy.stats.sem(values)
        )
        low = low if row.metric == "polish_gain" else max(low, 0.0)
        is_share = row.metric in ("true_connected_share", "predicted_min_connectivity")
        high = min(high, 1.0) if is_share else high
        assert (row.ci_low, row.ci_high) == pytest.approx((low, high))
        compared += 1
    assert compared > 5


def test_ratios_are_paired_with_the_first_setting(comparison):
    """Seed by seed, where both exist and are positive."""
    reference = runs_of(comparison, HORIZONS[0], COSTS[0])
    for row in comparison.rows:
        runs = runs_of(comparison, row.horizon, row.cost_to_go)
        ratios = []
        for run, other in zip(runs, reference, strict=True):
            assert run.seed == other.seed
            mine, its = run.metrics[row.metric], other.metrics[row.metric]
            if mine > 0.0 and its > 0.0:
                ratios.append(mine / its)
        if ratios:
            assert row.paired_ratio == pytest.approx(scipy.stats.gmean(ratios))
        else:
            assert row.paired_ratio is None
    first = rows_of(comparison, HORIZONS[0], COSTS[0])
    assert first["path_m"].paired_ratio == 1.0


def test_differences_are_paired_with_the_first_setting(comparison):
    """Seed by seed; with an interval from five seeds on, as of a paired t test."""
    rng = np.random.default_rng(0)
    runs = comparison.runs[:1] * 6

    def with_paths(lengths):
        metrics = [{**run.metrics, "path_m": v} for run, v in zip(runs, lengths, strict=True)]
        return [replace(run, metrics=m) for run, m in zip(runs, metrics, strict=True)]

    mine, its = rng.normal(50.0, 5.0, (2, 6))
    row = {r.metric: r for r in tabulate(with_paths(mine), with_paths(its))}["path_m"]
    test = scipy.stats.ttest_rel(mine, its)
    assert row.paired_difference == pytest.approx((mine - its).mean())
    assert (row.difference_low, row.difference_high) == pytest.approx(
        tuple(test.confidence_interval(0.95))
    )
    few = tabulate(with_paths(mine)[:3], with_paths(its)[:3])
    assert {r.metric: r for r in few}["path_m"].difference_low is None


def assert_same_run(one, other):
    for name in ("connectivity", "connected"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
    assert len(one.step_s) == len(other.step_s)
    assert repr(one.metrics) == repr(other.metrics)
    for name in ("horizon", "planner", "cost_to_go", "seed", "outcome", "reason", "rungs"):
        assert getattr(one, name) == getattr(other, name)
    assert one.verified_rate == other.verified_rate


def test_parallel_equals_serial(comparison, problem):
    parallel = compare(problem, HORIZONS, costs_to_go=COSTS, seeds=SEEDS, workers=2)
    for one, other in zip(comparison.runs, parallel.runs, strict=True):
        assert_same_run(one, other)
    for one, other in zip(comparison.rows, parallel.rows, strict=True):
        untimed = dict.fromkeys(TIMES, 0.0)
        assert replace(one, **untimed) == replace(other, **untimed)


def test_few_runs_and_no_steps(problem, comparison):
    """One run has no interval; runs at the goal from the start release and verify nothing."""
    alone = compare(problem, [2], planners=["lattice", "auto"], costs_to_go=["connected"], seeds=1)
    assert [run.planner for run in alone.runs] == ["lattice", "auto"]
    for row in alone.rows:
        assert row.ci_low is row.ci_high is None
        assert row.count <= 1
    robot = replace(problem.robots[0], goal_m=problem.robots[0].start_m)
    run = summary_of(simulate(replace(problem, robots=(robot,)), seed=0))
    rows = tabulate([run], [run])
    assert all(row.verified_rate is None for row in rows)
    assert all(row.p50_step_s is row.p95_step_s is None for row in rows)
    assert [row.mean for row in rows if row.metric == "path_m"] == [0.0]


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"horizons": []}, "horizons"),
        ({"planners": []}, "planners"),
        ({"costs_to_go": ()}, "costs_to_go"),
        ({"seeds": 0}, "seeds"),
        ({"seeds": -3}, "seeds"),
        ({"seeds": []}, "seeds"),
        ({"seeds": [1, -1]}, "seeds"),
        ({"seeds": [1, 2, 1]}, "seeds"),
        ({"seeds": "1:3"}, "seeds"),
        ({"seeds": 1.5}, "seeds"),
        ({"seeds": [0, 1.5]}, "seeds[1]"),
        ({"seeds": True}, "seeds"),
        ({"sweep": [0.5]}, "sweep"),
        ({"workers": 0}, "workers"),
        ({"workers": -1}, "workers"),
        ({"backend": "carrier pigeon"}, "backend"),
        ({"horizons": [4, 0]}, "planner.horizon"),
        ({"horizons": [501]}, "planner.horizon"),
        ({"planners": ["magic"]}, "planner.name"),
        ({"costs_to_go": ["cheap"]}, "objective.cost_to_go"),
        ({"sweep": {"constraints.p_min": []}}, "constraints.p_min"),
        ({"sweep": {"planner.horizon": [1]}, "horizons": [1]}, "planner.horizon"),
        ({"sweep": {"planner.name": ["lattice"]}, "planners": ["auto"]}, "planner.name"),
    ],
)
def test_bad_arguments(problem, options, key):
    """One clear error that names the argument, before anything runs."""
    arguments = {"horizons": [2], "seeds": 1, **options}
    with pytest.raises(InputError) as caught:
        compare(problem, on_run=lambda _: pytest.fail("ran"), **arguments)
    assert caught.value.key == key
    with refused():
        compare([problem, problem], [1])


def test_a_single_value_is_a_list_of_one(problem):
    several = compare(
        problem,
        [2],
        planners=["auto"],
        costs_to_go=["geodesic"],
        sweep={"constraints.p_min": [0.5]},
        seeds=[0],
    )
    alone = compare(
        problem,
        2,
        planners="auto",
        costs_to_go="geodesic",
        sweep={"constraints.p_min": 0.5},
        seeds=np.int64(1),
    )
    (run,), (same,) = several.runs, alone.runs
    assert run.sweep == same.sweep == {"constraints.p_min": 0.5}
    assert_same_run(run, same)


def test_intervals_and_ratios_of_odd_values():
    """None from fewer than five; cut to possible values; no ratio of NaN, zero or negatives."""
    for count in range(5):
        assert mean_interval(np.arange(float(count))) == (None, None)
    assert mean_interval(np.full(5, 3.0)) == (3.0, 3.0)
    shares = np.array([0.6, 1.0, 1.0, 1.0, 1.0])
    low, high = mean_interval(shares)
    assert low < 0.7 and high > 1.1
    assert mean_interval(shares, (0.0, 1.0)) == (low, 1.0)
    assert mean_interval(1.0 - shares, (0.0, 1.0)) == (0.0, pytest.approx(1.0 - low))
    nan, ones = float("nan"), np.ones(4)
    assert log_ratios(np.array([nan, 0.0, -1.0, nan]), ones).size == 0
    some = np.array([nan, 0.0, 2.0, 8.0])
    assert np.exp(log_ratios(some, ones)) == pytest.approx([2.0, 8.0])
    assert np.exp(log_ratios(ones, some)) == pytest.approx([0.5, 0.125])
