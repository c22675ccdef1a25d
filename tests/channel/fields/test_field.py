"""Shadowing fields have the covariance they claim."""

import numpy as np
import pytest

from planopt import InputError
from planopt.channel import shadow_field_db
from planopt.channel.shadow_fields import CLIPPED_SHARE_TOLERANCE


@pytest.mark.parametrize(("shape", "decorrelation"), [((12, 16), 5.0), ((6, 20), 16.0)])
def test_covariance_over_many_seeds(shape, decorrelation):
    """Mean products at several lags within 4 standard errors of xi^2 exp(-d / beta)."""
    generator = np.random.default_rng(3)
    fields = np.array(
        [shadow_field_db(shape, 2.0, 3.0, decorrelation, generator).values_db for _ in range(1000)]
    )
    assert np.abs(fields.mean(axis=0)).max() < 4.5 * 3.0 / np.sqrt(1000)
    for row, column in [(0, 0), (0, 1), (1, 0), (3, 4), (0, 15), (5, 0), (5, 11)]:
        products = fields[:, 0, 0] * fields[:, row, column]
        expected = 9.0 * np.exp(-2.0 * np.hypot(row, column) / decorrelation)
        error = products.std() / np.sqrt(len(products))
        assert abs(products.mean() - expected) < 4.0 * error


@pytest.mark.parametrize(("shape", "decorrelation"), [((10, 14), 3.0), ((7, 9), 12.0)])
def test_covariance_at_every_lag(shape, decorrelation):
    """All lags of the lattice, averaged over it, 4.5 errors."""
    generator = np.random.default_rng(9)
    means = []
    for _ in range(600):
        field = shadow_field_db(shape, 1.0, 2.0, decorrelation, generator).values_db
        lags = []
        for row in range(shape[0]):
            for column in range(shape[1]):
                moved = field[row:, column:]
                lags.append(np.mean(moved * field[: shape[0] - row, : shape[1] - column]))
        means.append(lags)
    means = np.array(means)
    rows, columns = np.indices(shape)
    expected = 4.0 * np.exp(-np.hypot(rows, columns) / decorrelation).ravel()
    error = means.std(axis=0) / np.sqrt(len(means))
    assert (np.abs(means.mean(axis=0) - expected) < 4.5 * error).all()


def test_opposite_edges_are_not_neighbours():
    """The torus is long enough: first and last column are as uncorrelated as their distance."""
    generator = np.random.default_rng(4)
    ends = np.array(
        [
            shadow_field_db((1, 40), 1.0, 1.0, 4.0, generator).values_db[0, [0, -1]]
            for _ in range(900)
        ]
    )
    assert abs(np.corrcoef(ends.T)[0, 1]) < 4.0 / np.sqrt(900)


def test_report_of_padding_and_clipping():
    """Padding grows with the decorrelation distance; what is clipped stays under tolerance."""
    short = shadow_field_db((10, 30), 1.0, 2.0, 1.0, np.random.default_rng(0))
    long = shadow_field_db((10, 30), 1.0, 2.0, 40.0, np.random.default_rng(0))
    assert short.values_db.shape == long.values_db.shape == (10, 30)
    assert min(short.padding) >= 10
    assert min(long.padding) > max(short.padding)
    assert 0.0 <= short.clipped_share <= CLIPPED_SHARE_TOLERANCE
    assert 0.0 <= long.clipped_share <= CLIPPED_SHARE_TOLERANCE


def test_seed_fixes_the_field_and_xi_scales_it():
    """Never standardised: doubling xi doubles the same realisation."""
    one = shadow_field_db((8, 8), 1.0, 2.0, 3.0, np.random.default_rng(5)).values_db
    again = shadow_field_db((8, 8), 1.0, 2.0, 3.0, np.random.default_rng(5)).values_db
    double = shadow_field_db((8, 8), 1.0, 4.0, 3.0, np.random.default_rng(5)).values_db
    np.testing.assert_array_equal(one, again)
    np.testing.assert_allclose(double, 2.0 * one)


def test_a_torus_that_does_not_fit_is_refused(monkeypatch):
    """A clear error instead of a machine out of memory."""
    monkeypatch.setattr("planopt.channel.shadow_fields.MAX_TORUS_CELLS", 10_000)
    with pytest.raises(InputError, match="decorrelation distance of 500 cells"):
        shadow_field_db((20, 20), 1.0, 2.0, 500.0, np.random.default_rng(0))
