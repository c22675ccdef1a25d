"""Pictures of snapshots: ages and reported sub-cells of what one mote knows."""

import numpy as np

from planopt.pursuit.knowledge import Track
from planopt.pursuit.service import SnapshotService
from planopt.report.pursuit_figure import draw_view


def test_view_of_one_mote():
    """Ages are of the finest level that shows a place; sub-cells hold where objects were seen."""
    service = SnapshotService(6, 1.0, 0.1, 2)
    generator = np.random.default_rng(0)
    tracks = [
        Track(np.array([0.0, 60.0]), np.stack([place, place + [3.0, -2.0]]))
        for place in generator.uniform(5.0, 55.0, (4, 2))
    ]
    mote = np.array([20, 33])
    panel = draw_view(service, tracks, mote, 60.0).axes[0]
    ages_s = np.asarray(panel.images[0].get_array())
    time_s = service.sample_numbers(60.0) * service.periods_s
    columns, rows = np.meshgrid(np.arange(64), np.arange(64))
    expected = np.full((64, 64), np.nan)
    for level in range(6, -1, -1):
        shown = (abs((columns >> level) - (mote[0] >> level)) <= 1) & (
            abs((rows >> level) - (mote[1] >> level)) <= 1
        )
        expected[shown] = 60.0 - time_s[level]
    np.testing.assert_allclose(ages_s, expected)
    squares = [line for line in panel.lines if len(line.get_xdata()) == 5]
    ways = [line for line in panel.lines if len(line.get_xdata()) == 2]
    assert len(squares) == len(ways) == len(tracks)
    for square, way in zip(squares, ways, strict=True):
        for get in ("get_xdata", "get_ydata"):
            around, first = getattr(square, get)(), getattr(way, get)()[0]
            assert around.min() <= first <= around.max()
