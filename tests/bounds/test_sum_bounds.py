"""Attacks on bounds of sums over steps: random paths, enumeration, wrong multipliers."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from sum_scene import (
    STEP_M,
    clear_of_all,
    random_paths,
    stages_in,
    sum_context,
    values_of,
    with_others,
)

from planopt.bounds.bound import Tilts, relative_gap
from planopt.bounds.multipliers import local_optimum, tilts_near
from planopt.bounds.tube import (
    FIRST_SHARE,
    StageProblem,
    divided,
    evaluated,
    first_cells,
    move_bounds,
    never_moved,
    proves,
    through_bounds,
    tube_bounds,
)
from planopt.extend import Dynamics
from planopt.objectives.upper_bounds import Discs, UpperBounds, sensing_bounds
from planopt.planning.values.context import StepContext
from planopt.problems import DoubleIntegrator, Unicycle
from planopt.robots.dynamics import rolled_out
from planopt.targets.information_filter import Sensor, sensing_information


def certificate(of_steps: np.ndarray, levels: int, value: float) -> Tilts:
    """A certificate of a robot without others."""
    return Tilts(of_steps, levels, value, levels, value)


def tightest(
    problem: StageProblem,
    context: StepContext,
    path: np.ndarray,
    seconds: float,
    known: float | None = None,
    levels: int = 30,
):
    """The last bound from the multipliers of a path, with its certificate.

    Bounds never fall below the `known` value, by default the path's: an attack needs a lower one.
    """
    kinks = np.vstack([station.measurements.positions_m for station in context.posteriors])
    tilts = tilts_near(problem, [path, local_optimum(problem, path)], kinks)
    value = float(values_of(context, path[None])[0]) if known is None else known
    *_, last = islice(tube_bounds(problem, value, tilts, seconds), levels)
    return last, certificate(np.array(tilts), last.levels, last.value)


@pytest.mark.parametrize("seed", range(12))
def test_no_cell_hides_a_better_path(seed: int) -> None:
    """The bound of each cell that a random path visits is at least the path's value."""
    generator = np.random.default_rng(seed)
    context = sum_context(seed, 4)
    problem, paths = stages_in(context), random_paths(context, 100, seed)
    values, side = values_of(context, paths), FIRST_SHARE * problem.step_m
    level = evaluated(problem, side, first_cells(problem))
    size = float(generator.choice([0.0, 0.1, 1.0, 10.0]))
    tilt = size * generator.normal(size=(4, 2))
    through, compared = through_bounds(level, [tilt]), 0
    for k in range(4):
        rows = {tuple(cell): row for row, cell in enumerate(level.active[k].tolist())}
        cells = np.floor((paths[:, k] - problem.start_m) / side).astype(int)
        for cell, value in zip(cells.tolist(), values.tolist(), strict=True):
            assert through[k][rows[tuple(cell)]] >= value - 1e-9 * abs(value)
            compared += 1
    print(f"{compared} comparisons")
    assert compared == 400


@pytest.mark.parametrize("seed", range(6))
def test_no_clear_path_is_excluded(seed: int) -> None:
    """Near other robots and obstacles, cells and moves of every clear path remain at all levels."""
    context = with_others(sum_context(seed, 4, energy=False), 1 + seed % 2, seed)
    problem = stages_in(context)
    paths = clear_of_all(context, random_paths(context, 400, seed))
    values, compared, excluded = values_of(context, paths), 0, 0
    side, active = FIRST_SHARE * problem.step_m, first_cells(problem)
    for _ in range(4):
        level = evaluated(problem, side, active)
        through = through_bounds(level, [np.zeros((4, 2))])
        visited = np.floor((paths - problem.start_m) / side).astype(int)
        rows = [
            {tuple(cell): row for row, cell in enumerate(cells.tolist())} for cells in level.active
        ]
        for path, value in zip(visited.tolist(), values.tolist(), strict=True):
            own = [row[tuple(cell)] for row, cell in zip(rows, path, strict=True)]
            assert min(through[k][row] for k, row in enumerate(own)) >= value - 1e-9 * abs(value)
            compared += 1
        for k in range(1, 4):
            near = np.ones((len(level.active[k - 1]), len(level.active[k])), dtype=np.bool_)
            never = never_moved(level, k, near)
            cells = zip(visited[:, k - 1].tolist(), visited[:, k].tolist(), strict=True)
            assert not any(never[rows[k - 1][tuple(a)], rows[k][tuple(b)]] for a, b in cells)
            excluded += int(never.sum())
        kept = [np.unique(visited[:, k], axis=0) for k in range(4)]
        side *= 0.5
        active = [divided(problem, cells, side, k + 1) for k, cells in enumerate(kept)]
    print(f"{compared} comparisons, {excluded} pairs of cells excluded")
    assert compared > 200 and excluded > 0


@pytest.mark.parametrize(
    ("dynamics", "motion"),
    [(DoubleIntegrator(STEP_M, 0.5), [0.6, -0.3]), (Unicycle(STEP_M, 0.3, -0.5), [2.0])],
    ids=["inertia", "heading"],
)
def test_no_driven_position_is_excluded(dynamics: Dynamics, motion: list[float]) -> None:
    """Cells of random drives remain at all levels, and cells that no drive reaches are dropped."""
    context = sum_context(1, 5, energy=False, plain=True)
    own = replace(context.problem.robots[0], dynamics=dynamics)
    context = replace(
        context,
        problem=replace(context.problem, robots=(own,)),
        state=np.concatenate([context.position_m, motion]),
    )
    problem, generator = stages_in(context), np.random.default_rng(1)
    inputs = generator.normal(0.0, 5.0, (4000, 5, 2))
    if isinstance(dynamics, Unicycle):
        inputs = np.clip(inputs, [-0.5, -0.3], [STEP_M, 0.3])
    else:
        inputs *= 0.5 / np.maximum(0.5, np.linalg.norm(inputs, axis=2))[..., None]
    drives = [rolled_out(dynamics, context.state, each, 1.0).states for each in inputs]
    states = np.array(drives)
    if not isinstance(dynamics, Unicycle):
        states = states[(np.linalg.norm(states[:, :, 2:], axis=2) <= STEP_M).all(axis=1)]
    paths, side, free = states[:, 1:, :2], FIRST_SHARE * problem.step_m, 0
    assert len(paths) > 500
    active, every = first_cells(problem), first_cells(replace(problem, may_reach=None))
    for _ in range(4):
        visited = np.floor((paths - problem.start_m) / side).astype(int)
        for k, (cells, more) in enumerate(zip(active, every, strict=True)):
            assert set(map(tuple, visited[:, k].tolist())) <= set(map(tuple, cells.tolist()))
            free += len(more) - len(cells)
        side *= 0.5
        active = [divided(problem, cells, side, k + 1) for k, cells in enumerate(active)]
        alone = replace(problem, may_reach=None)
        every = [divided(alone, cells, side, k + 1) for k, cells in enumerate(every)]
    print(f"{4 * 5 * len(paths)} comparisons, {free} cells dropped")
    assert free > 1000


def test_other_robots_tighten_the_bound() -> None:
    """Bounds near other robots are above the best clear path, and below those without robots."""
    gaps, compared = list[float](), 0
    for seed in range(20, 26):
        context = with_others(sum_context(seed, 4, energy=False), 2, seed)
        paths = clear_of_all(context, random_paths(context, 400, seed))
        if not len(paths):
            continue
        problem, values = stages_in(context), values_of(context, paths)
        best = paths[values.argmax()]
        last, _ = tightest(problem, context, best, 60.0, levels=4)
        free, _ = tightest(problem.alone(), context, best, 60.0, levels=4)
        assert values.max() <= last.value
        gaps.append(free.value / last.value - 1.0)
        compared += len(paths)
    print(f"{compared} comparisons, looser without robots by {np.round(gaps, 4)}")
    assert compared > 200 and max(gaps) > 1e-3


def gap_of(seed: int, seconds: float) -> tuple[float, bool]:
    """The signed gap of the best of 60 random paths of a scene, and whether they keep p_min."""
    context = sum_context(seed, int(np.random.default_rng(seed).integers(1, 6)))
    paths = random_paths(context, 60, seed)
    chance = context.law.probability(paths.reshape(-1, 2)).reshape(len(paths), -1)
    connected = paths[(chance >= 0.6).all(axis=1)]
    bounded = seed % 2 == 1 and len(connected) > 1
    paths = connected if bounded else paths
    problem, values = stages_in(context, 0.6 if bounded else 0.0), values_of(context, paths)
    worse = int(np.random.default_rng(seed).integers(0, 2 * len(paths) // 3))
    known = float(np.sort(values)[worse])
    last, _ = tightest(problem, context, paths[values.argmax()], seconds, known)
    return relative_gap(float(values.max()), last.value, "max"), bounded


def compare(seeds: range, seconds: float) -> int:
    """Compare bounds with random paths and local optima; return the number of scenes."""
    found = {seed: gap_of(seed, seconds) for seed in seeds}
    gaps = {seed: gap for seed, (gap, _) in found.items()}
    least = min(gaps, key=lambda seed: gaps[seed])
    bounded = sum(each for _, each in found.values())
    words = f"{bounded} with p_min, least gap {gaps[least]:.2e} (seed {least})"
    print(f"{len(gaps)} comparisons of the best random path, {words}")
    assert gaps[least] >= 0.0, f"seed {least}"
    assert bounded > 0
    return len(gaps)


def test_no_known_path_is_better() -> None:
    """Fifteen random scenes; the slow test has ten thousand."""
    assert compare(range(100, 115), 0.1) == 15


@pytest.mark.slow
def test_no_known_path_is_better_in_ten_thousand_scenes() -> None:
    """Ten thousand comparisons in random scenes."""
    assert compare(range(1000, 11_000), 0.1) == 10_000


def test_enumeration_of_two_steps() -> None:
    """All pairs of positions on a grid are below the bound, which is close to their maximum."""
    compared, gaps = 0, list[float]()
    for seed in range(6):
        context = sum_context(seed, 2, plain=True)
        problem, here = stages_in(context), context.position_m
        line = np.linspace(-STEP_M, STEP_M, 9)
        moves = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
        moves = moves[np.hypot(*moves.T) <= STEP_M]
        first = here + moves
        paths = np.stack(
            [np.repeat(first, len(moves), axis=0), (first[:, None] + moves).reshape(-1, 2)], axis=1
        )
        values = values_of(context, paths)
        last, _ = tightest(problem, context, paths[values.argmax()], 0.6)
        assert values.max() <= last.value
        gaps.append(last.value / values.max() - 1.0)
        compared += len(paths)
    print(f"{compared} comparisons, gaps {np.round(gaps, 4)}")
    assert compared > 10_000
    assert np.median(gaps) < 0.05


def test_multistart_finds_nothing_better() -> None:
    """Local optima from random paths stay below the bound of the best of them."""
    compared = 0
    for seed in range(4):
        context = sum_context(seed, 3, energy=False, plain=True)
        problem = stages_in(context)
        found = [local_optimum(problem, path) for path in random_paths(context, 8, seed)]
        paths = np.array([kept_within(path, context.position_m) for path in found])
        values = values_of(context, paths)
        last, _ = tightest(problem, context, paths[values.argmax()], 0.5)
        assert values.max() <= last.value
        compared += len(paths)
    print(f"{compared} comparisons")
    assert compared == 32


def kept_within(path: np.ndarray, here: np.ndarray) -> np.ndarray:
    """A path with its steps shortened to the longest step, inside the workspace."""
    found = path.copy()
    for k, place in enumerate(path):
        move = np.clip(place, 0.0, 40.0) - here
        here = here + move * min(1.0, STEP_M / max(float(np.hypot(*move)), 1e-12))
        found[k] = here
    return found


def test_wrong_multipliers_only_loosen() -> None:
    """A disturbed certificate proves its value only if that is above every known path."""
    generator = np.random.default_rng(0)
    compared = proven = 0
    for seed in range(4):
        context = sum_context(seed, 3)
        problem, paths = stages_in(context), random_paths(context, 200, seed)
        values = values_of(context, paths)
        last, tilts = tightest(problem, context, paths[values.argmax()], 0.4)
        assert proves(problem, tilts)
        assert not proves(problem, certificate(tilts.of_steps[:, :2], 3, last.value))
        for scale in (1e-3, 0.1, 10.0, np.nan):
            steps = tilts.of_steps + scale * generator.normal(size=tilts.of_steps.shape)
            for share in (0.9, 1.0, 1.5):
                value = values.max() + (share - 1.0) * abs(values.max())
                if proves(problem, certificate(steps, 3, value)):
                    assert value >= values.max()
                    proven += 1
                compared += 1
    print(f"{compared} comparisons, {proven} of them proven")
    assert compared == 48 and proven > 0


def test_p_min_leaves_connected_paths() -> None:
    """With p_min, the bound is at least the value of every path that keeps it, and no looser."""
    compared = 0
    for seed in range(8):
        context = sum_context(seed, 3, energy=False)
        free, bound = stages_in(context), stages_in(context, p_min=0.6)
        paths = random_paths(context, 300, seed)
        chance = context.law.probability(paths.reshape(-1, 2)).reshape(len(paths), -1)
        paths = paths[(chance >= 0.6).all(axis=1)]
        if not len(paths):
            continue
        values = values_of(context, paths)
        best = paths[values.argmax()]
        last, tilts = tightest(bound, context, best, 0.6)
        assert values.max() <= last.value
        loose, _ = tightest(free, context, best, 0.1)
        assert tilts.levels == 1 or last.value <= loose.value * 1.01
        compared += len(paths)
    print(f"{compared} comparisons")
    assert compared > 300


def test_enclosures_hold_inside_their_discs() -> None:
    """Samples of sensing, its product with a linear function, and moves stay below the bounds."""
    generator = np.random.default_rng(0)
    compared = 0
    for _ in range(60):
        sensor = Sensor(*generator.uniform([0.005, 0.05, 0.0], [0.5, 1.0, 5.0]).tolist())
        target, radius = generator.normal(size=2), float(generator.choice([1e-6, 0.1, 2.0]))
        centre = target + generator.normal(0.0, 4.0, (5, 2))
        bounds = sensing_bounds(sensor, target, Discs(centre, radius))
        slope = generator.normal(size=(5, 2))
        level = np.hypot(*slope.T) * radius + generator.uniform(size=5)
        linear = UpperBounds(level, slope, level + np.hypot(*slope.T) * radius, radius)
        product = bounds.times(linear)
        angle, share = generator.uniform(0.0, 2.0 * np.pi, 200), generator.uniform(size=200)
        offset = radius * np.sqrt(share)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        for row in range(5):
            value = sensing_information(sensor, centre[row] + offset, target)
            factor = level[row] + offset @ slope[row]
            for each, truth in ((bounds, value), (product, value * factor)):
                assert (truth <= each.value[row] + offset @ each.slope[row] + 1e-9).all()
                assert (truth <= each.most[row] + 1e-9).all()
                compared += 2 * len(truth)
    context = sum_context(0, 2)
    problem = stages_in(context)
    for _ in range(200):
        multiplier = generator.normal(0.0, float(generator.choice([0.0, 0.1, 2.0])), 2)
        half = float(generator.choice([0.01, 0.3, 1.0]))
        offset = generator.normal(0.0, 1.0, (1, 2)) * generator.choice([0.0, 1.0])
        moves = offset + generator.uniform(-half, half, (300, 2))
        length = np.hypot(*moves.T)
        moves, length = moves[length <= problem.step_m], length[length <= problem.step_m]
        away = np.hypot(*np.maximum(np.abs(offset) - half, 0.0).T)
        worth = moves @ multiplier - problem.per_metre * length
        worth -= np.where(length > problem.standstill_m, problem.per_move, 0.0)
        assert (worth <= move_bounds(problem, multiplier, offset, half, away) + 1e-9).all()
        compared += len(worth)
    print(f"{compared} comparisons")
    assert compared > 100_000
