"""Maps of the posterior agree with predictions place by place."""

import sys

import numpy as np
import pytest
from refusals import refused
from scipy.stats import norm

from planopt.channel import ChannelParameters, Measurements, Station, condition, posterior_map
from planopt.channel import channel_map as module
from planopt.channel.channel_map import default_cell_m, measured_bounds_m

PARAMETERS = ChannelParameters(-30.0, 2.5, 4.0, 15.0, 1.5, Station((50.0, 60.0), 5.0))


def measured(count: int) -> Measurements:
    generator = np.random.default_rng(2)
    places = generator.uniform((0.0, 0.0), (100.0, 80.0), (count, 2))
    return Measurements(places, generator.normal(-70.0, 6.0, count), np.zeros(count, dtype=bool))


def test_cell_by_cell() -> None:
    """Mean, deviation and the normal probability at the centre of a cell."""
    posterior = condition(PARAMETERS, measured(40))
    maps = posterior_map(posterior, (0.0, 10.0, 100.0, 45.0), 10.0, -72.0)
    assert maps.posterior == "exact" and maps.threshold_dbm == -72.0
    assert maps.mean_db.values.shape == (4, 10)
    one = posterior.predict(np.array([[75.0, 35.0]]))
    assert maps.mean_db.x_m[7] == 75.0 and maps.mean_db.y_m[2] == 35.0
    mean, deviation = maps.mean_db.values[2, 7], maps.deviation_db.values[2, 7]
    assert mean == pytest.approx(one.mean_db[0]) and deviation == pytest.approx(one.deviation_db[0])
    assert maps.connectivity.values[2, 7] == pytest.approx(norm.sf(-72.0, mean, deviation))


def test_nearest_measurements_agree_with_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many measurements are mapped by neighbours, within the accuracy stated."""
    posterior = condition(PARAMETERS, measured(400))
    bounds = (0.0, 0.0, 100.0, 80.0)
    exact = posterior_map(posterior, bounds, 5.0, -72.0)
    monkeypatch.setattr(module, "EXACT_OPERATIONS", 1e6)
    near = posterior_map(posterior, bounds, 5.0, -72.0)
    assert (exact.posterior, near.posterior) == ("exact", "neighbours:256")
    assert 0.0 < np.abs(near.mean_db.values - exact.mean_db.values).max() < 0.1
    np.testing.assert_allclose(near.deviation_db.values, exact.deviation_db.values, rtol=1e-3)


def test_default_grid() -> None:
    """About 200 cells along the longer side of what was measured; a line is widened."""
    places = np.array([[3e6, 10.0], [3e6 + 500.0, 10.0], [3e6 + 20.0, 10.0]])
    bounds = measured_bounds_m(Measurements(places, np.zeros(3), np.zeros(3, dtype=bool)))
    assert bounds == (3e6, 7.5, 3e6 + 500.0, 12.5)
    assert default_cell_m(bounds) == 2.5
    box = measured_bounds_m(measured(50))
    np.testing.assert_allclose(box[:2], measured(50).positions_m.min(axis=0))
    np.testing.assert_allclose(box[2:], measured(50).positions_m.max(axis=0))
    assert 190 <= (box[2] - box[0]) / default_cell_m(box) <= 211


def test_as_xarray(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values by coordinates with units; without the package the error says what to install."""
    pytest.importorskip("xarray")
    maps = posterior_map(condition(PARAMETERS, measured(40)), (0.0, 10.0, 100.0, 45.0), 10.0, -72.0)
    dataset = maps.to_xarray()
    assert dict(dataset.sizes) == {"y_m": 4, "x_m": 10}
    for name, raster in (
        ("mean_dbm", maps.mean_db),
        ("deviation_db", maps.deviation_db),
        ("connectivity", maps.connectivity),
    ):
        assert float(dataset[name].sel(x_m=75.0, y_m=35.0)) == raster.values[2, 7]
    assert dataset["mean_dbm"].attrs["units"] == "dBm"
    assert dataset.attrs == {"threshold_dbm": -72.0, "posterior": "exact"}
    monkeypatch.setitem(sys.modules, "xarray", None)
    maps = posterior_map(condition(PARAMETERS, measured(9)), (0.0, 0.0, 20.0, 20.0), 10.0, -72.0)
    with refused():
        maps.to_xarray()
