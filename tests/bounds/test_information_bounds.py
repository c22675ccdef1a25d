"""Attacks on bounds of information: random and enumerated paths, random designs, cell pairs."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from sum_scene import random_paths, stages_in, sum_context, values_of

import planopt
from planopt.bounds.bound import Design, Tilts, relative_gap
from planopt.bounds.enclosure import PowerEnclosure, prior_covariances
from planopt.bounds.multipliers import fitted_parts
from planopt.bounds.stages import are_designs
from planopt.bounds.tube import cut_limits, tube_bounds
from planopt.objectives.moments import posterior_moments
from planopt.objectives.upper_bounds import Discs, Field
from planopt.planning.prove import largest_bounds

CRITERIA = ("map", "D", "A", "V", "T")


def random_design(seed: int, path: np.ndarray) -> Design:
    """Measurements around a path with random weights, some of them zero, as a wrong multiplier."""
    generator = np.random.default_rng(seed)
    places = path[generator.integers(0, len(path), 6)]
    places = places + generator.normal(0.0, generator.choice([0.0, 1.0, 5.0]), places.shape)
    weights = 10.0 ** generator.uniform(-4.0, 1.0, (6, 2)) * generator.integers(0, 2, (6, 2))
    root = generator.normal(0.0, 10.0 ** generator.uniform(-3.0, 1.0), (2, 2))
    known = root.T @ root * generator.integers(0, 2)
    return Design(places_m=places, weights=weights, path_loss=0.5 * (known + known.T))


def random_cuts(seed: int, path: np.ndarray) -> np.ndarray:
    """Up to two cuts (c, 4) of random parts, at coordinates near those of a path (N, 2)."""
    generator = np.random.default_rng(seed)
    count = int(generator.integers(0, 3))
    stage, axis = generator.integers(0, len(path), count), generator.integers(0, 2, count)
    at_m = path[stage, axis] + generator.normal(0.0, generator.choice([1e-3, 1.0]), count)
    part = generator.integers(0, np.arange(count) + 1)
    return np.column_stack([part, stage, axis, at_m])


def relaxed_values(context, design: Design, paths: np.ndarray) -> np.ndarray:
    """The relaxed values of paths (n, N, 2) themselves, without cells."""
    problem = stages_in(context, design=design)
    found = np.zeros(len(paths))
    for number, path in enumerate(paths):
        field = Field(Discs(path, 0.0), problem.makers)
        for stage in range(len(path)):
            found[number] += problem.reward(stage, field.at(np.array([stage]))).most[0]
        if problem.chain is not None:
            covariance = posterior_moments(problem.chain.posterior, path).universal
            own = np.diag(covariance)
            shared = np.diag(covariance, 1) ** 2 / (own[1:] * own[:-1])
            found[number] += problem.chain.share * np.log1p(-shared).sum()
    return found


@pytest.mark.parametrize("measured", CRITERIA)
def test_no_path_has_more_than_its_relaxed_value(measured: str) -> None:
    """Random paths of 40 scenes, with designs of three kinds: random, none, the path itself."""
    compared, least = 0, np.inf
    for seed in range(40):
        context = sum_context(seed, 4, energy=False, plain=True, measured=measured)
        paths = random_paths(context, 15, seed)
        values = values_of(context, paths)
        own = Design(places_m=paths[0], weights=np.tile([1.0, 0.1], (4, 1)))
        for design in (random_design(seed, paths[0]), Design(), own):
            gaps = relaxed_values(context, design, paths) - values
            least = min(least, float((gaps / np.maximum(np.abs(values), 1e-6)).min()))
            compared += len(gaps)
    print(f"{measured}: {compared} comparisons, least gap {least:.1e}")
    assert compared == 1800 and least >= -1e-8


def gap_of(seed: int, seconds: float) -> float:
    """The signed gap of the best of 60 random paths of a scene, relative to its value."""
    steps, measured = int(np.random.default_rng(seed).integers(2, 6)), CRITERIA[seed // 2 % 5]
    context = sum_context(seed, steps, energy=seed % 2 == 0, plain=True, measured=measured)
    paths = random_paths(context, 60, seed)
    values = values_of(context, paths)
    best, known = float(values.max()), float(np.median(values))
    problem, path, cuts = stages_in(context), paths[values.argmax()], np.zeros((0, 4))
    designs = [Design()]
    if seed % 3 == 0:  # Random designs of up to three parts, cut near the path
        cuts = random_cuts(seed, path)
        designs = [random_design(seed + part, path) for part in range(len(cuts) + 1)]
    if seed % 3 == 1:
        fits, cuts = fitted_parts(
            lambda each: stages_in(context, design=each), problem.measured, path, known, seconds
        )
        designs = [each.design for each in fits]
    limits = cut_limits(problem.limits_m, cuts)
    parts = [
        replace(stages_in(context, design=design), limits_m=each)
        for design, each in zip(designs, limits, strict=True)
    ]
    *_, last = largest_bounds(parts, known, [], seconds)
    return relative_gap(best, last.value, "max")


def compare(seeds: range, seconds: float) -> int:
    """Compare bounds with random paths; return the number of scenes."""
    gaps = {seed: gap_of(seed, seconds) for seed in seeds}
    least = min(gaps, key=lambda seed: gaps[seed])
    middle = [f"{np.median([gaps[seed] for seed in seeds if seed % 3 == k]):.1%}" for k in range(3)]
    print(
        f"{len(gaps)} comparisons of the best of 60 paths, least gap {gaps[least]:.2e} (seed "
        f"{least}), medians with random, fitted and no designs: {', '.join(middle)}"
    )
    assert gaps[least] >= 0.0, f"seed {least}"
    return len(gaps)


def test_no_known_path_measures_more() -> None:
    """Thirty random scenes; the slow test has a thousand."""
    assert compare(range(30), 0.05) == 30


@pytest.mark.slow
def test_no_known_path_measures_more_in_a_thousand_scenes() -> None:
    """A thousand comparisons in random scenes."""
    assert compare(range(1000, 2000), 0.05) == 1000


def test_every_path_belongs_to_a_part() -> None:
    """Random paths, with positions exactly at cuts, lie within the limits of one part at least."""
    compared = 0
    for seed in range(60):
        context = sum_context(seed, 3, plain=True, measured="map")
        paths = random_paths(context, 40, seed)
        cuts = np.vstack([random_cuts(seed + 1000 * k, paths[k]) for k in range(3)])
        cuts[:, 0] = np.random.default_rng(seed).integers(0, np.arange(len(cuts)) + 1)
        for number, (_, stage, axis, at_m) in enumerate(cuts):
            paths[number, int(stage), int(axis)] = at_m
        limits = np.array(cut_limits(stages_in(context).limits_m, cuts))
        inside = (paths[:, None] >= limits[:, :, :2]) & (paths[:, None] <= limits[:, :, 2:])
        clipped = ((paths >= 0.0) & (paths <= 40.0)).all(axis=(1, 2))
        assert inside.all(axis=(2, 3)).any(axis=1)[clipped].all()
        compared += int(clipped.sum())
    print(f"{compared} comparisons")
    assert compared > 2000


def test_damaged_designs_prove_nothing() -> None:
    """Designs and cuts of a saved bound that do not fit each other are not used."""
    solution = planopt.solve(planopt.load("indoor_learn"), seed=3, horizon=4, prove_s=1.0)
    assert solution.plan.bound is not None
    tilts = solution.plan.bound.certificate
    assert isinstance(tilts, Tilts) and are_designs(tilts, 4)
    # The time limit decides how many cuts a proof has: this one has a cut, with one design twice.
    own = tilts.owner == 0
    tilts = replace(
        tilts,
        places_m=np.vstack([tilts.places_m[own]] * 2),
        weights=np.vstack([tilts.weights[own]] * 2),
        path_loss=np.vstack([tilts.path_loss[:2]] * 2),
        owner=np.repeat([0, 1], own.sum()),
        cuts=np.array([[0.0, 1.0, 0.0, 10.0]]),
    )
    assert are_designs(tilts, 4)
    for column, wrong in ((0, 99.0), (0, -1.0), (1, 4.0), (2, 2.0), (3, np.nan), (3, np.inf)):
        cuts = tilts.cuts.copy()
        cuts[-1, column] = wrong
        assert not are_designs(replace(tilts, cuts=cuts), 4)
    assert not are_designs(replace(tilts, cuts=tilts.cuts[:-1]), 4)
    assert not are_designs(replace(tilts, owner=tilts.owner[:-1]), 4)


@pytest.mark.parametrize("measured", CRITERIA)
def test_no_enumerated_path_measures_more(measured: str) -> None:
    """All paths of two moves in 12 directions with three lengths, in two scenes."""
    compared = 0
    for seed in (3, 4):
        context = sum_context(seed, 2, energy=False, plain=True, measured=measured)
        angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
        units = np.column_stack([np.cos(angles), np.sin(angles)])
        moves = np.vstack([[[0.0, 0.0]], *(length * units for length in (0.5, 1.5, 2.0))])
        paths = context.position_m + np.array(
            [np.cumsum(pair, axis=0) for pair in product(moves, moves)]
        )
        values = values_of(context, paths)
        own = Design(places_m=paths[values.argmax()], weights=np.tile([1.0, 0.1], (2, 1)))
        problem = stages_in(context, design=own)
        *_, last = tube_bounds(problem, float(np.median(values)), [], 0.3)
        assert values.max() <= last.value
        compared += len(paths)
    print(f"{measured}: {compared} comparisons")
    assert compared == 2738


def test_covariances_of_cells_are_bounded_from_below() -> None:
    """Covariances of random positions in pairs of cells are at least their affine bounds."""
    generator, compared, tight = np.random.default_rng(0), 0, list[float]()
    for seed in range(60):
        context = sum_context(seed, 2, plain=True)
        posterior = context.posteriors[0]
        if seed % 2:
            posterior = replace(posterior, theta_covariance=np.zeros((2, 2)))
        enclosure, parameters = PowerEnclosure(posterior), posterior.parameters
        for side in (0.1, 0.5, 2.0):
            radius = side * np.sqrt(0.5)
            centres = generator.uniform(2.0, 38.0, (2, 2))
            if seed % 3 == 0:  # Cells with a measurement, and neighbours
                centres[0] = posterior.measurements.positions_m[0] + 0.3 * side
                centres[1] = centres[0] + side * generator.integers(-1, 2, 2)
            one, two = (enclosure.joint(each[None], radius) for each in centres)
            offset = centres[1] - centres[0]
            inside = centres + generator.uniform(-0.5 * side, 0.5 * side, (50, 2, 2))
            away = np.hypot(*(inside[:, 1] - inside[:, 0]).T)
            prior, bounds = prior_covariances(offset, radius, float(away.max()), parameters)
            centre, least, slopes = one.covariances(two)
            for (value, steep), places in product(bounds, inside):
                exact = posterior_moments(posterior, places).universal[0, 1]
                own, other = places - centres
                bound = value + least[0] + own @ (slopes[0][0] + steep)
                bound += other @ (slopes[1][0] - steep)
                assert bound <= exact + 1e-7
                compared += 1
            tight.append(float((prior + centre[0] - bounds[-1][0] - least[0]) / side**2))
    print(f"{compared} comparisons, median remainder {np.median(tight):.2f} dB^2 for cells of 1 m")
    assert compared > 9000


def test_bounds_of_information_are_saved_and_proven_again(tmp_path) -> None:
    """``check`` proves the bounds of ``outdoor_map`` and ``indoor_learn`` from the saved plans."""
    for name in ("outdoor_map", "indoor_learn"):
        solution = planopt.solve(planopt.load(name), seed=3, horizon=4, prove_s=0.5)
        bound = solution.plan.bound
        assert bound is not None and bound.gap is not None and 0.0 <= bound.gap < 0.3
        solution.save(tmp_path / name)
        assert planopt.check(tmp_path / name).verdict is planopt.Verdict.VERIFIED
        again = planopt.load_result(tmp_path / name).plan.bound
        assert again is not None and again.value == pytest.approx(bound.value, rel=1e-9)


def test_losses_by_distance_are_lower_bounds() -> None:
    """Two measurements share at least the information of equation 9.18, also near the station."""
    generator, compared, tight = np.random.default_rng(1), 0, list[float]()
    for seed in range(40):
        context = sum_context(seed, 2, plain=True, measured="map")
        chain = stages_in(context).chain
        assert chain is not None
        station = chain.posterior.parameters.station
        for _ in range(20):
            here = np.asarray(station.position_m) + generator.normal(0.0, 3.0, 2)
            both = np.vstack([here, here + generator.normal(0.0, generator.choice([0.1, 1.0]), 2)])
            covariance = posterior_moments(chain.posterior, both).universal
            product_db4 = covariance[0, 0] * covariance[1, 1]
            shared = -chain.share * np.log1p(-(covariance[0, 1] ** 2) / product_db4)
            near = np.hypot(*(both - station.position_m).T).min(keepdims=True).clip(0.1)
            away = float(np.hypot(*(both[1] - both[0])))
            [lost] = chain.lost_at_least(away, near, np.array([np.sqrt(product_db4)]))
            assert lost <= shared + 1e-9
            tight.append(lost / shared)
            compared += 1
    print(f"{compared} comparisons, median share of the loss {np.median(tight):.2f}")
    assert compared == 800 and max(tight) > 0.1
