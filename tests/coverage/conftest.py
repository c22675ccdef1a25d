"""Regions that tests of coverage share."""

from __future__ import annotations

import numpy as np
import pytest

from planopt.coverage import ConvexRegion, convex_region


@pytest.fixture
def square() -> ConvexRegion:
    """A square of 100 m."""
    return convex_region(np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]]))


@pytest.fixture
def hexagon() -> ConvexRegion:
    """An irregular hexagon far from the origin."""
    corners = np.array([[0, 0], [60, -10], [110, 30], [100, 80], [40, 95], [-10, 50]])
    return convex_region(corners + np.array([4000.0, -900.0]))
