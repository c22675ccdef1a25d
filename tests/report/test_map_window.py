"""The window of a plan's map."""

import numpy as np
import pytest
from scenes import small_problem

from planopt.report.map_window import BORDER, window_about


@pytest.mark.parametrize("seed", range(5))
def test_places_are_shown_and_little_outside_the_workspace(seed: int) -> None:
    """A square, with room around the places."""
    generator = np.random.default_rng(seed)
    problem = small_problem(bounds_m=(-50.0, 0.0, 70.0, 120.0))
    for _ in range(20):
        places = generator.uniform((-50.0, 0.0), (70.0, 120.0), (4, 2))
        x_min, y_min, x_max, y_max = window_about(problem, places)
        side = x_max - x_min
        assert side == pytest.approx(y_max - y_min)
        assert (places > (x_min, y_min)).all() and (places < (x_max, y_max)).all()
        low, high = BORDER * side, 120.0 + BORDER * side
        if side <= high + low:
            edge = 1e-9
            assert min(x_min + 50.0, y_min) >= -low - edge
            assert max(x_max + 50.0, y_max) <= high + edge


def test_a_station_outside_the_bounds_stays_in_sight() -> None:
    """Of a team's map."""
    problem = small_problem(bounds_m=(0.0, 0.0, 40.0, 30.0))
    places = np.array([[5.0, 5.0], [90.0, 10.0]])
    x_min, y_min, x_max, y_max = window_about(problem, places)
    assert x_min < 5.0 and x_max > 90.0 and y_min < 5.0 and y_max > 10.0
