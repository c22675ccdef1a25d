"""Shadowing at scattered places has the covariance it claims."""

import numpy as np
import pytest

from planopt import InputError
from planopt.channel import scattered_field_db, shadow_field_db
from planopt.channel.shadow_fields import added_to_lattice_db

DRAWS = 1200


def within_errors(draws, expected):
    """Every sample covariance within 4.5 standard errors (zero mean, Gaussian)."""
    found = draws.T @ draws / len(draws)
    variance = np.diag(expected)
    error = np.sqrt((variance[:, None] * variance + expected**2) / len(draws))
    assert (np.abs(found - expected) < 4.5 * error).all()


def covariance(places, std, decorrelation):
    """xi^2 exp(-d / beta), by hand."""
    return std**2 * np.exp(-np.hypot(*(places[:, None] - places).T) / decorrelation)


def test_covariance_of_places():
    """At near, far and collinear places, over many seeds."""
    generator = np.random.default_rng(1)
    places = np.array([[0, 0], [0.1, 0], [3, 0], [6, 0], [3e6, 1], [3e6, 5], [-4, 7]], dtype=float)
    draws = np.array([scattered_field_db(places, 3.0, 5.0, generator) for _ in range(DRAWS)])
    within_errors(draws, covariance(places, 3.0, 5.0))


def test_repeated_places_share_their_value():
    """Exactly, in any order; places that differ by rounding do not break the factor."""
    places = np.array([[1.0, 2.0], [5.0, 5.0], [1.0, 2.0], [1.0 + 1e-15, 2.0], [1.0, 2.0 + 1e-12]])
    values = scattered_field_db(places, 2.0, 5.0, np.random.default_rng(2))
    assert values[0] == values[2] != values[1]
    assert np.abs(values[3:] - values[0]).max() < 1e-3
    assert scattered_field_db(places[:0], 2.0, 5.0, np.random.default_rng(2)).shape == (0,)


def test_too_many_places(monkeypatch):
    """A clear error instead of a machine out of memory; repeated places do not count."""
    monkeypatch.setattr("planopt.channel.shadow_fields.MAX_PLACES", 3)
    generator = np.random.default_rng(0)
    scattered_field_db(np.zeros((10, 2)), 1.0, 1.0, generator)
    with pytest.raises(InputError, match="4 places are too many"):
        scattered_field_db(np.eye(4, 2).cumsum(axis=0) + np.arange(4)[:, None], 1.0, 1.0, generator)


def test_places_added_to_a_lattice():
    """Lattice and places together have the covariance of one field, inside and at the border."""
    generator = np.random.default_rng(3)
    x, y = np.arange(8.0), np.arange(6.0)
    places = np.array([[3.4, 2.2], [3.6, 2.2], [3.0, 2.0], [7.7, 5.3], [0.2, 3.9], [3.4, 2.9]])
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    shown = [0, 7, 19, 20, 28, 47]
    draws = []
    for _ in range(DRAWS):
        field = shadow_field_db((6, 8), 1.0, 2.0, 4.0, generator).values_db
        added = added_to_lattice_db(x, y, field, places, 2.0, 4.0, generator)
        draws.append(np.concatenate([field.ravel()[shown], added]))
    draws = np.array(draws)
    within_errors(draws, covariance(np.concatenate([nodes[shown], places]), 2.0, 4.0))
    # A place on a node takes the node's value.
    np.testing.assert_allclose(draws[:, 8], draws[:, 2], atol=0.01)


def test_a_lattice_of_two_cells():
    """Short axes have fewer nodes to draw from."""
    generator = np.random.default_rng(4)
    axis = np.array([0.0, 1.0])
    drawn = added_to_lattice_db(
        axis, axis, np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[1.0, 0.0]]), 2.0, 4.0, generator
    )
    assert drawn[0] == pytest.approx(2.0, abs=0.01)
