"""Scores against examples worked out by hand."""

import math

import numpy as np
import pytest
import scipy.stats
from bench_rows import row

from planopt.studies.bench_references import (
    LIMIT_S,
    SHIFT_S,
    best_known,
    claims,
    is_solved,
    is_wrong,
    performance_profile,
    scores,
    shifted_geometric_mean,
    time_profile,
    worse_share,
)

INF, NOT_ASKED = math.inf, math.nan


def test_profile_by_hand() -> None:
    """Ratios to the fastest of three solvers; units and the order of questions change nothing."""
    times_s = np.array(
        [[1.0, 2.0, NOT_ASKED], [6.0, 2.0, NOT_ASKED], [INF, 0.5, 2.0], [INF, INF, INF]]
    )
    ratios, shares = performance_profile(times_s)
    assert ratios.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert shares.tolist() == [
        [0.25, 0.25, 0.5, 0.5],
        [0.5, 0.75, 0.75, 0.75],
        [0.0, 0.0, 0.0, 0.5],
    ]
    times_s = np.random.default_rng(3).exponential(1.0, (20, 3)) + 1e-3
    times_s[3, 1] = INF
    ratios, shares = performance_profile(times_s)
    for other in (1e3 * times_s, times_s[::-1]):
        again, same = performance_profile(other)
        assert again == pytest.approx(ratios) and same.tolist() == shares.tolist()
    assert (np.diff(shares, axis=1) >= 0.0).all()
    assert shares[:, -1].tolist() == [1.0, 0.95, 1.0]


def test_shifted_geometric_mean() -> None:
    """Without shift SciPy's; with one by hand; a single time is itself."""
    times_s = np.array([0.5, 2.0, 8.0])
    assert shifted_geometric_mean(times_s, 0.0) == pytest.approx(scipy.stats.gmean(times_s))
    assert shifted_geometric_mean(np.array([1.0, 7.0]), 1.0) == pytest.approx(4.0 - 1.0)
    assert shifted_geometric_mean(np.array([3.0]), 0.01) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("objective", "best", "sense", "share"),
    [(101.0, 100.0, "min", 0.01), (99.0, 100.0, "max", 0.01), (-101.0, -100.0, "max", 0.01)]
    + [(90.0, 100.0, "min", -0.1), (0.0, 0.0, "min", 0.0)],
)
def test_worse_share(objective: float, best: float, sense: str, share: float) -> None:
    """Positive is worse, whatever the sense and the sign."""
    assert worse_share(objective, best, sense) == pytest.approx(share)


BEST = {row().question: 100.0}
ERROR = {"outcome": "error", "termination": "no_path"}


@pytest.mark.parametrize(
    ("changes", "solved", "claimed", "wrong"),
    [
        ({}, True, True, False),
        ({"objective": 100.9}, True, True, False),
        ({"objective": 101.1}, False, True, True),
        ({"objective": 101.1, "termination": "lattice_only"}, False, True, False),
        ({"objective": 90.0}, True, True, False),
        ({"accepted": False}, False, True, True),
        ({"verdict": "violated"}, False, True, False),
        ({"verdict": "violated", "termination": "iteration_limit"}, False, False, False),
        ({"verdict": "none", "outcome": "no_plan", "objective": None}, False, True, True),
        ({**ERROR, "verdict": "none", "objective": None}, False, False, False),
    ],
)
def test_solved_and_wrong(changes, solved: bool, claimed: bool, wrong: bool) -> None:
    """A claim that does not hold is worse than no claim."""
    one = row(**changes)
    assert (is_solved(one, BEST), claims(one), is_wrong(one, BEST)) == (solved, claimed, wrong)


def test_scores_by_hand() -> None:
    """Two planners, two questions: the second planner claims an optimum that is none."""
    rows = [
        row(planner="a"),
        row(planner="a", seed=1, rungs={"lattice": 1}, cpu_s=0.3),
        row(planner="b", objective=110.0, iterations=4),
        row(planner="b", seed=1, objective=100.5, cpu_s=0.2),
    ]
    best = best_known({}, rows)
    assert list(best.values()) == [100.0, 100.0]
    first, second = scores(rows, best)
    assert (first.planner, first.cases) == ("a", 2)
    assert (first.success_rate, first.correct_rate) == (1.0, 1.0)
    assert first.fallback_share == 0.5 and first.iterations == 12.0
    assert first.mean_s == pytest.approx(math.sqrt(0.11 * 0.31) - SHIFT_S)
    assert (second.success_rate, second.correct_rate, second.verified_rate) == (0.5, 0.5, 1.0)
    assert second.median_excess == pytest.approx(0.0525)
    assert second.largest_excess == pytest.approx(0.1)
    assert second.mean_s == pytest.approx(math.sqrt((LIMIT_S + 0.01) * 0.21) - SHIFT_S)
    assert second.median_s == pytest.approx(0.2)
    profile = time_profile(rows, best)
    assert profile.ratios.tolist() == pytest.approx([1.0, 1.5])
    assert profile.shares.tolist() == [[0.5, 1.0], [0.5, 0.5]]


def test_rejected_answers_set_no_mark() -> None:
    """What the check rejects, or the verifier does not pass, is not the best known."""
    rows = [row(), row(objective=10.0, accepted=False), row(objective=10.0, verdict="violated")]
    assert best_known({}, rows) == {row().question: 100.0}
    none = row(verdict="none", outcome="no_plan", objective=None, termination="no_path")
    assert is_solved(none, {}) and not is_wrong(none, {})
