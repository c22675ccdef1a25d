"""Regions that tests of coverage share."""

import numpy as np
import pytest

from planopt.coverage import ConvexRegion, convex_region


@pytest.fixture
def square() -> ConvexRegion:
    return convex_region(np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]]))


@pytest.fixture
def hexagon() -> ConvexRegion:
    corners = np.array([[0, 0], [60, -10], [110, 30], [100, 80], [40, 95], [-10, 50]])
    return convex_region(corners + np.array([4000.0, -900.0]))
