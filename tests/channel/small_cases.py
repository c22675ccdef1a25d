"""Small sets of measurements, many of them degenerate, for tests that nothing breaks on them."""

import numpy as np

from planopt.channel import Measurements, Station

FAR = 3e6
"""Coordinates of map projections."""


def small_case(seed):
    """2 to 30 measurements and a station.

    By turns spread, on a line, on a line with the station, on a circle about it, repeated, in
    clumps, at map coordinates, on a lattice and nearly in one place; powers constant, quiet or
    wild; some censored, rounded, dated, by several receivers or with errors of position.
    """
    rng = np.random.default_rng(seed)
    count, size = int(rng.integers(2, 31)), 10.0 ** rng.uniform(-1.0, 3.0)
    few = rng.uniform(0.0, size, (max(count // 4, 1), 2))
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    offset = np.zeros(2)
    kind = seed % 9
    if kind == 0:
        positions = rng.uniform(0.0, size, (count, 2))
    elif kind == 1:
        positions = np.outer(rng.uniform(1.0, size + 1.0, count), [1.0, 2.0]) + [0.0, size]
    elif kind == 2:
        positions = np.outer(rng.uniform(-size, size, count), [0.6, 0.8])
    elif kind == 3:
        positions = size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    elif kind == 4:
        positions = few[rng.integers(0, len(few), count)]
    elif kind == 5:
        clumps = few[rng.integers(0, len(few), count)]
        positions = clumps + 1e-6 * size * rng.standard_normal((count, 2))
    elif kind == 6:
        positions, offset = rng.uniform(0.0, size, (count, 2)), np.array([FAR, 2.0 * FAR])
    elif kind == 7:
        positions = size * rng.integers(0, 3, (count, 2)).astype(float)
    else:
        positions = size + 10.0 ** rng.uniform(-12.0, -3.0) * rng.standard_normal((count, 2))
    power = -60.0 + rng.choice([0.0, 1.0, 10.0, 100.0]) * rng.standard_normal(count)
    if seed % 5 == 0:
        power = np.full(count, -70.0)
    resolution = rng.choice([0.0, 0.0, 1.0, 10.0])
    if resolution:
        power = resolution * np.round(power / resolution)
    censored = rng.uniform(size=count) < rng.choice([0.0, 0.0, 0.3, 0.8, 1.0])
    return (
        Measurements(
            positions + offset,
            power,
            censored,
            resolution_db=np.full(count, resolution),
            position_std_m=np.full(count, rng.choice([0.0, 0.0, 0.01 * size])),
            time_s=rng.uniform(0.0, 100.0, count),
            receiver=rng.integers(0, rng.choice([1, 1, 3]), count),
        ),
        Station((float(offset[0]), float(offset[1])), rng.choice([0.0, 5.0])),
        rng.choice([np.inf, np.inf, 30.0]),
    )


def assert_usable(fit):
    """Check that a fit is finite, positive where it must be, and consistent with its own words."""
    p = fit.parameters
    numbers = [p.k_pl_db, p.n_pl, p.shadow_std_db, p.decorrelation_m, p.multipath_std_db]
    assert np.isfinite(numbers).all() and np.isfinite(fit.theta_covariance).all()
    assert min(numbers[2:]) > 0.0
    assert (np.array(list(fit.standard_errors.values())) >= 0.0).all()
    eigenvalues = np.linalg.eigvalsh(fit.theta_covariance)
    assert eigenvalues[0] >= -1e-9 * eigenvalues[1]
    assert fit.status == "ok" or fit.warnings
