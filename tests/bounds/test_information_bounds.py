"""Attacks on bounds of mapped information: random paths, and losses between two measurements."""

from dataclasses import replace

import numpy as np
import pytest
from sum_scene import random_paths, stages_in, sum_context, values_of

import planopt
from planopt.bounds.bound import relative_gap
from planopt.bounds.tube import tube_bounds, untilted
from planopt.objectives.moments import posterior_moments
from planopt.objectives.upper_bounds import PairedInformation


def gap_of(seed: int, seconds: float) -> float:
    """The signed gap of the best of 60 random paths of a scene, relative to its value."""
    steps = int(np.random.default_rng(seed).integers(2, 6))
    context = sum_context(seed, steps, energy=seed % 2 == 0, plain=True, mapped=True)
    paths = random_paths(context, 60, seed)
    values = values_of(context, paths)
    best, known = float(values.max()), float(np.median(values))
    problem = stages_in(context, path=paths[values.argmax()] if seed % 3 else None)
    assert problem.paired is not None
    *_, last = tube_bounds(problem, known, [untilted(problem)], seconds)
    return relative_gap(best, last.value, "max")


def compare(seeds: range, seconds: float) -> int:
    """Compare bounds with random paths; return the number of scenes."""
    gaps = {seed: gap_of(seed, seconds) for seed in seeds}
    least = min(gaps, key=lambda seed: gaps[seed])
    words = (
        f"least gap {gaps[least]:.2e} (seed {least}), median {np.median(list(gaps.values())):.1%}"
    )
    print(f"{len(gaps)} comparisons of the best of 60 paths, {words}")
    assert gaps[least] >= 0.0, f"seed {least}"
    return len(gaps)


def test_no_known_path_maps_more() -> None:
    """Twenty random scenes; the slow test has three thousand."""
    assert compare(range(20), 0.05) == 20


@pytest.mark.slow
def test_no_known_path_maps_more_in_three_thousand_scenes() -> None:
    """Three thousand comparisons in random scenes."""
    assert compare(range(1000, 4000), 0.05) == 3000


def test_losses_are_lower_bounds() -> None:
    """The information shared by two measurements is at least the loss, also from bounds of both."""
    generator, compared, tight = np.random.default_rng(0), 0, list[float]()
    for seed in range(40):
        context = sum_context(seed, 2, plain=True)
        for spread in (context.posteriors[0].theta_covariance, np.zeros((2, 2))):
            paired = PairedInformation(replace(context.posteriors[0], theta_covariance=spread))
            station = paired.posterior.parameters.station
            for _ in range(10):
                here = generator.uniform(0.0, 40.0, 2)
                there = here + generator.normal(0.0, generator.choice([0.1, 1.0, 5.0]), 2)
                both = np.vstack([here, there])
                covariance = posterior_moments(paired.posterior, both).universal
                one, other = np.diag(covariance)
                shared = 0.5 * np.log(one * other / np.linalg.det(covariance))
                away = float(np.hypot(*(there - here)))
                near = np.hypot(*(both - station.position_m).T).min(keepdims=True)
                wide = 1.0 + 0.3 * generator.uniform(size=2) * generator.integers(0, 2)
                least, most = np.array([one / wide[0]]), np.array([other * wide[1]])
                [lost] = paired.lost(least, most, away, near)
                # A looser bound of the later variance may be charged to its own information.
                assert lost <= shared + 0.5 * np.log(wide[1]) + 1e-9
                tight.append(lost / max(shared, 1e-9))
                compared += 1
    print(f"{compared} comparisons, median share of the loss {np.median(tight):.2f}")
    assert compared == 800 and np.median(tight) > 0.1


def test_the_bound_of_a_map_is_saved_and_proven_again(tmp_path) -> None:
    """``check`` proves the bound of ``outdoor_map`` from the saved plan."""
    solution = planopt.solve(planopt.load("outdoor_map"), seed=1, horizon=4, prove_s=0.5)
    bound = solution.plan.bound
    assert bound is not None and bound.gap is not None and 0.0 <= bound.gap < 0.15
    solution.save(tmp_path)
    assert planopt.check(tmp_path).verdict is planopt.Verdict.VERIFIED
    again = planopt.load_result(tmp_path).plan.bound
    assert again is not None and again.value == pytest.approx(bound.value, rel=1e-9)
