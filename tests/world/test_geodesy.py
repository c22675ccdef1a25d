"""Degrees and metres east and north of an origin."""

import numpy as np
import pytest
from refusals import refused

from planopt.world.geodesy import FARTHEST_M, east_north_m, longitude_latitude_deg, parse_origin

ORIGINS = [(48.1374, 11.5755), (0.0, 0.0), (-33.9, 151.2), (78.2, -179.9)]
TURNED = [*ORIGINS, (48.1374, 11.5755, 30.0), (-33.9, 151.2, -200.0)]


@pytest.mark.parametrize("origin", ORIGINS)
def test_agrees_with_proj(origin: tuple[float, float]) -> None:
    """PROJ keeps distances (azimuthal equidistant), the plane shortens them by d^3 / 6 R^2.

    So does the direction agree: both have it right at the origin.
    """
    warp = pytest.importorskip("rasterio.warp")
    generator = np.random.default_rng(0)
    latitude = origin[0] + generator.uniform(-0.08, 0.08, 50)
    longitude = origin[1] + generator.uniform(-0.08, 0.08, 50)
    local = f"+proj=aeqd +lat_0={origin[0]} +lon_0={origin[1]} +ellps=WGS84 +units=m"
    globe = "+proj=longlat +ellps=WGS84"
    expected = np.stack(warp.transform(globe, local, longitude, latitude), axis=-1)
    found = east_north_m(longitude, latitude, origin)
    distance = np.linalg.norm(expected, axis=-1)
    assert distance.max() > 5000.0
    error = np.linalg.norm(found - expected, axis=-1)
    assert (error <= 1e-4 + 1.1 * distance**3 / (6.0 * 6.33e6**2)).all()


def test_frames_at_the_edge() -> None:
    """The date line, distances beyond the plane, and axes that are not east and north."""
    found = east_north_m(np.array([-179.99, 179.99]), np.array([10.0, 10.0]), (10.0, 180.0))
    assert found[0, 0] == pytest.approx(-found[1, 0]) and 0.0 < found[0, 0] < 1200.0
    degree_m = 111_132.0
    near, far = 0.99 * FARTHEST_M / degree_m, 1.01 * FARTHEST_M / degree_m
    found = east_north_m(np.zeros(3), np.array([45.0 + near, 45.0 + far, -45.0]), (45.0, 0.0))
    assert np.isfinite(found[0]).all() and np.isnan(found[1:]).all()
    longitude, latitude = np.array([11.58, 11.57]), np.array([48.14, 48.13])
    east, north = east_north_m(longitude, latitude, ORIGINS[0]).T
    x, y = east_north_m(longitude, latitude, (*ORIGINS[0], 90.0)).T
    np.testing.assert_allclose([x, y], [north, -east], atol=1e-6)
    assert parse_origin("48.1374, 11.5755, 90") == (*ORIGINS[0], 90.0)


@pytest.mark.parametrize("origin", TURNED)
def test_the_inverse(origin: tuple[float, float]) -> None:
    """Positions up to 90 km away return to a millimetre."""
    generator = np.random.default_rng(1)
    angle, away = generator.uniform(0.0, 2.0 * np.pi, 200), generator.uniform(0.0, 9e4, 200)
    places = away[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    longitude, latitude = longitude_latitude_deg(places, origin).T
    assert (np.abs(longitude) <= 180.0).all()
    np.testing.assert_allclose(east_north_m(longitude, latitude, origin), places, atol=1e-3)


@pytest.mark.parametrize(
    "text",
    ["", "48", "48,1,11,5", "48.0,11.0,361", "a,b", "nan,0", "90,0", "0,181", "inf,0"]
    + ["48,11,5", "48.1374,11,57", "48,13,11.57"],
)
def test_origins_that_are_none(text: str) -> None:
    """Neither is the pole one: it has no east. Three numbers may be two with a comma."""
    with refused():
        parse_origin(text)
