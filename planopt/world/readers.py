"""Readers of obstacles from files (GeoJSON, WKT, ray-tracing scenes, grids) and from objects."""

import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import shapely

from planopt.arrays import Floats
from planopt.errors import InputError
from planopt.files.reading import read_text
from planopt.world.geodesy import Origin, east_north_m, require_origin
from planopt.world.occupancy import OccupancyGrid, UnknownCells, grid_obstacles, is_grid, read_grid
from planopt.world.workspace import Obstacle, footprint

WKT_EXAMPLE = "write POLYGON ((0 0, 4 0, 4 3, 0 0)), repeating the first corner at the end"

DEEPEST = 32  # Maximum nesting depth of geometries, which protects the stack of recursive parsers
NEAR_DEG = 1.0
"""Distance in degrees from the origin up to which GeoJSON without a system counts as degrees."""
EPSG = re.compile(r"EPSG:+(?:[\d.]*:)?(\d{4,6})\b", re.IGNORECASE)
"""Pattern of the EPSG code of a reference system."""
SURELY_DEGREES = 20.0
"""Ratio of distance from the origin to extent above which coordinates count as degrees."""

_GEOJSON = "give GeoJSON of Polygon or MultiPolygon features, or buildings with an exterior"

_AREAS = "obstacles are polygons; draw the outline of the area"

_Part = TypeVar("_Part")


def read_obstacles(
    path: Path, unknown: UnknownCells = "occupied", origin_deg: Origin | None = None
) -> tuple[Obstacle, ...]:
    """Return the obstacles in a file, read according to its extension.

    With an origin, GeoJSON in degrees or in another reference system is converted to metres.
    """
    ending = path.suffix.lower()
    try:
        if is_grid(path):
            return grid_obstacles(read_grid(path), path.stem, unknown)
        if ending == ".wkt":
            return tuple(_from_wkt_file(path.stem, read_text(path)))
        if ending in (".geojson", ".json"):
            return _from_json(path.stem, read_text(path), origin_deg)
    except InputError as error:
        raise error.located(path) from error
    raise InputError(
        f"is not a file of obstacles: the ending {ending!r} is unknown",
        file=path,
        remedy="use a name that ends in .geojson, .json, .wkt, .yaml or .csv",
    )


def obstacle_from_wkt(name: str, text: str) -> Obstacle:
    """Return the obstacle of a WKT polygon in metres."""
    obstacles = list(obstacles_of_geometry(name, _parsed_wkt(name, text)))
    if len(obstacles) != 1:
        raise InputError(
            f"{name}: one obstacle consists of {len(obstacles)} polygons",
            remedy="make one obstacle for each polygon",
        )
    return obstacles[0]


def _from_wkt_file(stem: str, text: str) -> Iterator[Obstacle]:
    """Yield the obstacles of a WKT file with one geometry, or one per line."""
    whole = _tolerant_wkt(text)
    if whole is not None:
        yield from obstacles_of_geometry(stem, whole)
        return
    lines = [(row, line) for row, line in enumerate(text.splitlines(), start=1) if line.strip()]
    if not lines:
        raise InputError("the file is empty", remedy="give a GeoJSON or WKT file with polygons")
    for row, line in lines:
        name = stem if len(lines) == 1 else f"{stem} line {row}"
        try:
            yield from obstacles_of_geometry(name, _parsed_wkt(name, line))
        except InputError as error:
            message = error.message.removeprefix(f"{name}: ")
            raise InputError(message, row=row, remedy=error.remedy) from error


def _tolerant_wkt(text: str) -> shapely.Geometry | None:
    """Return the geometry of a WKT text with closed rings; None if it is invalid."""
    letters = np.frombuffer(text.encode(), dtype=np.uint8)
    depth = np.cumsum((letters == ord("(")).astype(np.int64) - (letters == ord(")")))
    if depth.max(initial=0) > DEEPEST:
        raise InputError(f"the WKT is nested too deeply ({depth.max()} levels)", remedy=WKT_EXAMPLE)
    try:
        with np.errstate(all="ignore"):
            return cast("shapely.Geometry | None", shapely.from_wkt(text, on_invalid="fix"))
    except NotImplementedError:  # curves
        return None


def _parsed_wkt(name: str, text: str) -> shapely.Geometry:
    """Return the geometry of a WKT text; raise an InputError with the reason if it is invalid."""
    geometry = _tolerant_wkt(text)
    if geometry is not None:
        return geometry
    try:
        return shapely.from_wkt(text)
    except (shapely.GEOSException, NotImplementedError) as error:
        # GEOS puts the name of its exception in front.
        fault = re.sub(r"^\w+Exception: ", "", str(error))
        raise InputError(f"{name}: invalid WKT: {fault}", remedy=WKT_EXAMPLE) from error


def obstacles_of_geometry(name: str, geometry: shapely.Geometry) -> Iterator[Obstacle]:
    """Yield the obstacles of a polygon or a collection, numbered if there are several."""
    if isinstance(geometry, shapely.Polygon):
        exterior, *holes = (
            shapely.get_coordinates(ring).tolist()
            for ring in (geometry.exterior, *geometry.interiors)
        )
        yield footprint(name, exterior, holes)
    elif isinstance(geometry, (shapely.MultiPolygon, shapely.GeometryCollection)):
        parts = shapely.get_parts(cast("shapely.Geometry", geometry))
        for part_name, part in _numbered(name, list(parts), "part "):
            yield from obstacles_of_geometry(part_name, part)
    else:
        raise InputError(f"{name}: a {type(geometry).__name__} is not a polygon", remedy=_AREAS)


def _from_json(stem: str, text: str, origin_deg: Origin | None) -> tuple[Obstacle, ...]:
    """Return the obstacles of a building file or a GeoJSON text."""
    try:
        data: Any = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(
            f"invalid JSON: {error.msg}",
            row=error.lineno,
            remedy="correct the JSON; a WKT file needs a name that ends in .wkt",
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"invalid JSON: {error}", remedy=_GEOJSON) from error
    try:
        obstacles = list(_areas(stem, data))
    except RecursionError:
        raise InputError("the GeoJSON is nested too deeply", remedy=_GEOJSON) from None
    if obstacles and "buildings" not in data:
        obstacles = _in_metres(data, obstacles, origin_deg)
    return tuple(obstacles)


def _in_metres(
    table: dict[str, object], obstacles: list[Obstacle], origin_deg: Origin | None
) -> list[Obstacle]:
    """Return the obstacles of GeoJSON, projected to metres from the origin if they are not."""
    polygons = np.array([one.polygon for one in obstacles], dtype=np.object_)
    corners = shapely.get_coordinates(polygons)
    system = json.dumps(table.get("crs") or "")
    code, named = EPSG.search(system), DEGREES.search(system)
    if origin_deg is not None:
        is_near = (np.abs(corners - np.array(origin_deg[:2])[::-1]) < NEAR_DEG).all()
        if code or named or is_near:
            degrees = corners if named or code is None else _degrees_of(corners, int(code[1]))
            metres = east_north_m(degrees[:, 0], degrees[:, 1], origin_deg)
            if not np.isfinite(metres).all():
                raise InputError(
                    "has coordinates far from the origin",
                    key="origin_deg",
                    remedy="give the origin as latitude, longitude, close to the obstacles",
                )
            placed = shapely.set_coordinates(polygons, metres)
            return [
                replace(one, polygon=polygon)
                for one, polygon in zip(obstacles, placed, strict=True)
            ]
    # RFC 7946 prescribes degrees, which must not be taken for metres.
    x, y = corners.T
    within = np.abs(x).max() <= 180.0 and np.abs(y).max() <= 90.0
    extent = max(np.ptp(x), np.ptp(y))
    afar = np.hypot(np.abs(x).min(), np.abs(y).min()) > SURELY_DEGREES * extent
    if within and (named or afar):
        raise InputError(
            f"the coordinates, such as {x[0]:g}, {y[0]:g}, are degrees of longitude and latitude",
            remedy="give the origin of the frame as origin_deg = [LAT, LON]; if these are metres, "
            "save them as .wkt",
        )
    return obstacles


def _degrees_of(corners: Floats, code: int) -> Floats:
    """Return longitudes and latitudes (n, 2) of positions in the reference system EPSG `code`."""
    try:
        pyproj: Any = import_module("pyproj")
    except ImportError:
        raise InputError(
            f"has the reference system EPSG:{code}, which needs pyproj",
            remedy="pip install 'planopt[maps]'",
        ) from None
    try:
        convert = pyproj.Transformer.from_crs(code, 4326, always_xy=True)
    except pyproj.exceptions.CRSError as error:
        raise InputError(
            f"has the unknown reference system EPSG:{code}", remedy="give a valid EPSG code"
        ) from error
    return np.stack(convert.transform(*corners.T), axis=-1)


def _areas(name: str, value: Any) -> Iterator[Obstacle]:
    """Yield the obstacles of a building table or a GeoJSON object (RFC 7946, in metres)."""
    match value:
        case {"buildings": [*buildings]}:
            for number, building in enumerate(buildings, start=1):
                yield _building(f"building {number}", building)
        case {"type": "FeatureCollection", "features": [*features]}:
            for number, feature in enumerate(features, start=1):
                yield from _areas(f"feature {number}", feature)
        case {"type": "Feature", "geometry": geometry, "properties": {"name": own}} if (
            own is not None
        ):
            yield from _areas(str(own), geometry)
        case {"type": "Feature", "geometry": geometry}:
            yield from _areas(str(value.get("id", name)), geometry)
        case {"type": "GeometryCollection", "geometries": [*parts]}:
            for part_name, part in _numbered(name, parts, "part "):
                yield from _areas(part_name, part)
        case {"type": "MultiPolygon", "coordinates": [*parts]}:
            for part_name, rings in _numbered(name, parts, "part "):
                yield from _areas(part_name, {"type": "Polygon", "coordinates": rings})
        case {"type": "Polygon", "coordinates": [*rings]}:
            exterior, *holes = rings or [[]]
            yield footprint(name, exterior, holes)
        case _:
            raise InputError(f"{name}: {_short(value)} is not a polygon", remedy=_GEOJSON)


def _building(name: str, value: Any) -> Obstacle:
    """Return the obstacle of one building table."""
    match value:
        case {"exterior": exterior, "holes": [*holes]}:
            return footprint(str(value.get("name", name)), exterior, holes)
        case {"exterior": exterior} if not value.get("holes"):
            return footprint(str(value.get("name", name)), exterior)
        case _:
            pass
    raise InputError(
        f"{name}: {_short(value)} has no exterior ring, or an invalid hole", remedy=_GEOJSON
    )


DEGREES = re.compile(r"CRS84|EPSG:+(\d*:)?(4326|4258|4269)\b", re.IGNORECASE)
"""Pattern of reference systems in degrees."""


def _numbered(name: str, parts: list[_Part], word: str = "") -> Iterator[tuple[str, _Part]]:
    """Yield each part with a name: `name` for a single part, numbered names for several."""
    for number, part in enumerate(parts, start=1):
        yield (name if len(parts) == 1 else f"{name} {word}{number}"), part


def _short(value: object) -> str:
    """Return `value` as JSON, truncated for a message."""
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:40]}..."


def obstacles_from(
    source: Any, name: str = "obstacle", *, origin_deg: Origin | None = None
) -> tuple[Obstacle, ...]:
    """Create obstacles from files, geometries, tables of geometries, corners or grids.

    Parameters
    ----------
    source
        File of obstacles (GeoJSON, WKT) or of an occupancy grid (Nav2 YAML, CSV), whose unknown
        cells are occupied; shapely polygon or collection of polygons; GeoDataFrame or GeoSeries,
        with names from the column ``name`` if present; array ``(n, 2)`` of corners of an obstacle;
        :class:`planopt.problems.OccupancyGrid`; or a list of any of these, including obstacles.
        Coordinates are metres in the frame of the problem.
    name
        Name of obstacles without their own name; several are numbered.
    origin_deg
        Latitude and longitude of (0, 0), and the angle from east to the x axis if it is not 0, in
        degrees. If given, GeoJSON and GeoDataFrames in degrees or in another reference system are
        projected to metres.

    Raises
    ------
    InputError
        An entry is not an area, or a polygon is invalid.

    Examples
    --------
    >>> import shapely
    >>> from planopt import obstacles_from
    >>> [each.name for each in obstacles_from([shapely.box(0, 0, 1, 1), [(3, 0), (4, 0), (4, 2)]])]
    ['obstacle 1', 'obstacle 2']
    """
    origin = None if origin_deg is None else require_origin(tuple(origin_deg), "origin_deg")
    return tuple(_obstacles(source, name, origin))


def _obstacles(source: Any, name: str, origin_deg: Origin | None) -> Iterator[Obstacle]:
    if isinstance(source, Obstacle):
        yield source
    elif isinstance(source, str | Path):
        yield from read_obstacles(Path(source), origin_deg=origin_deg)
    elif isinstance(source, shapely.Geometry):
        yield from obstacles_of_geometry(name, source)
    elif isinstance(source, OccupancyGrid):
        yield from grid_obstacles(source, name)
    elif hasattr(source, "geometry"):
        geometries = list(cast("Iterable[Any]", source.geometry))
        if origin_deg is not None and getattr(source, "crs", None) is not None:
            origin = origin_deg

            def plane(degrees: Floats) -> Floats:
                return east_north_m(degrees[:, 0], degrees[:, 1], origin)

            geometries = [shapely.transform(each, plane) for each in source.to_crs(4326).geometry]
        names = [own for own, _ in _numbered(name, geometries)]
        if "name" in getattr(source, "columns", ()):
            names = map(str, source["name"])
        for own, geometry in zip(names, geometries, strict=True):
            yield from _obstacles(geometry, own, None)
    elif getattr(source, "dtype", None) == np.bool_:
        raise InputError(
            f"{name}: an array of bool with shape {np.shape(source)} is an occupancy grid, but "
            "its position is missing",
            key="world.obstacles",
            remedy="give planopt.problems.OccupancyGrid(occupied, unknown, resolution_m=0.5, "
            "origin_m=(0.0, 0.0))",
        )
    elif _is_ring(source):
        yield footprint(name, cast("Any", np.asarray(source)).tolist())
    elif isinstance(source, Iterable) and not isinstance(source, bytes):
        entries = list(cast("Iterable[Any]", source))
        for own, entry in _numbered(name, entries):
            yield from _obstacles(entry, own, origin_deg)
    else:
        raise InputError(
            f"{name}: an object of type {type(source).__name__} is not a polygon",
            key="world.obstacles",
            remedy="give a file, polygons, a GeoDataFrame, corners (n, 2) or an OccupancyGrid",
        )


def _is_ring(source: Any) -> bool:
    """Return whether `source` is a list or an array of corners (n, 2)."""
    try:
        corners = np.asarray(source, dtype=np.float64)
    except (TypeError, ValueError):
        return False
    return corners.ndim == 2 and corners.shape[1] == 2
