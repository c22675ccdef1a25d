"""Occupancy grids: file readers, and exact obstacle polygons of closed cells.

ROS: the keys of the YAML file have the same meaning as for ``map_server`` and Nav2; pixels that are
not opaque are unknown. CSV: a row of names ``resolution_m,origin_x_m,origin_y_m,occupied_from``, a
row of their values, then the rows of the map, largest y first; negative and empty cells are
unknown. Cells that share an edge form one obstacle within a tile of `TILE_CELLS` x `TILE_CELLS`
cells: the walls of a whole building would be one polygon with thousands of corners, which slows
every distance query. Obstacles that touch along a tile side or at a corner leave no gap.
"""

import io
import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from planopt.arrays import Floats, Indices, Mask
from planopt.errors import InputError
from planopt.files.reading import csv_rows, foreign_reader, read_bytes, read_text
from planopt.keys import LARGEST_COORDINATE_M
from planopt.short_repr import short_repr
from planopt.world.workspace import Obstacle

UnknownCells = Literal["occupied", "free"]
"""Treatment of unknown cells: like occupied or like free ones."""
MOST_CELLS = 16_000_000  # Maximum number of cells in a grid: 200 x 200 m at 5 cm
MOST_EDGES = 2_000_000
"""Maximum number of outline edges. The map of a building has some tens of thousands."""


TILE_CELLS = 32  # Number of cells per side of the tiles into which obstacles are cut
SMALLEST_CORNER = 1e-6
"""Area, in cells, below which an uncovered corner beside a rotated grid is a rounding error."""


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Occupancy grid: a map of square cells.

    Attributes
    ----------
    occupied, unknown
        ``(ny, nx)`` masks of occupied and of unknown cells; row 0 has the smallest y. All other
        cells are free.
    resolution_m
        Side of a cell.
    origin_m
        ``(x, y)`` of the outer corner of cell [0, 0].
    grey_free_cells
        Number of free cells with grey value 205, which ROS writes for unknown cells.
    yaw_rad
        Angle from the x axis to the rows of the grid, counter-clockwise around `origin_m`.
    """

    occupied: Mask
    unknown: Mask
    resolution_m: float
    origin_m: tuple[float, float]
    grey_free_cells: int = 0
    yaw_rad: float = 0.0

    __repr__ = short_repr

    @property
    def corners_m(self) -> Floats:
        """Return the corners (4, 2) of the grid along its outline."""
        rows, columns = self.occupied.shape
        return self.placed_m(np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]]))

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """Return ``(x_min, y_min, x_max, y_max)`` of the grid."""
        (x_min, y_min), (x_max, y_max) = self.corners_m.min(axis=0), self.corners_m.max(axis=0)
        return float(x_min), float(y_min), float(x_max), float(y_max)

    def placed_m(self, corners: Indices) -> Floats:
        """Return the positions (n, 2) of cell corners given by column and row."""
        along = self.resolution_m * corners.astype(np.float64)
        if self.yaw_rad:
            cosine, sine = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
            along = along @ np.array([[cosine, sine], [-sine, cosine]])
        return np.array(self.origin_m) + along

    def __post_init__(self) -> None:
        for key in ("occupied", "unknown"):
            cells = np.asarray(getattr(self, key))
            if cells.dtype.kind != "b" or cells.ndim != 2:
                raise InputError(
                    f"has shape {cells.shape} and type {cells.dtype}, should be a "
                    "two-dimensional array of bool",
                    key=key,
                    remedy="give an array (ny, nx), e.g. probabilities > 0.65",
                )
            object.__setattr__(self, key, cells)
        if self.unknown.shape != self.occupied.shape:
            raise InputError(
                f"has shape {self.unknown.shape}, but occupied has shape {self.occupied.shape}",
                key="unknown",
                remedy="give one value for each cell; numpy.zeros_like(occupied) if all cells are "
                "known",
            )
        try:
            numbers = np.array([self.resolution_m, *self.origin_m, self.yaw_rad], dtype=np.float64)
        except (TypeError, ValueError):
            numbers = np.full(4, np.nan)
        if numbers.shape != (4,) or not (np.isfinite(numbers).all() and numbers[0] > 0.0):
            raise InputError(
                f"has a grid with a wrong resolution_m ({self.resolution_m!r}), origin_m "
                f"({self.origin_m!r}) or yaw_rad ({self.yaw_rad!r})",
                key="world.obstacles",
                remedy="give a resolution above 0 m, and the corner (x, y) of the grid in metres",
            )


def grid_obstacles(
    grid: OccupancyGrid, name: str, unknown: UnknownCells = "occupied"
) -> tuple[Obstacle, ...]:
    """Return obstacles that cover exactly the forbidden cells of a grid.

    Corners of the bounds that a rotated grid does not cover count as unknown.
    """
    closed = grid.occupied | grid.unknown if unknown == "occupied" else grid.occupied
    polygons: list[shapely.Polygon] = list(_polygons(closed, grid)) if closed.any() else []
    if grid.yaw_rad and unknown == "occupied":
        outside = shapely.box(*grid.bounds_m) - shapely.Polygon(grid.corners_m)
        corners = shapely.get_parts(outside)
        polygons += [each for each in corners if each.area > SMALLEST_CORNER * grid.resolution_m**2]
    return tuple(
        Obstacle(name if len(polygons) == 1 else f"{name} {number}", polygon)
        for number, polygon in enumerate(polygons, start=1)
    )


@dataclass(frozen=True)
class _Edges:
    """Outline edges of components, each with its closed cell on the left."""

    end: Indices  # (e, 2) column and row of the end corner
    label: Indices  # (e,) component of the closed cell, from 1
    following: Indices  # (e,) index of the next edge along the outline
    turns: Mask  # (e,) whether the next edge has another direction


def _edges(closed: Mask) -> _Edges:
    """Return all outline edges of the connected components of closed cells."""
    # If two closed cells touch at a corner only, the outline continues along the other cell if both
    # belong to one component, else along its own cell. No outline thus touches itself.
    ny, nx = closed.shape
    # Open rows and columns between tiles separate components during labelling.
    row, column = np.arange(ny, dtype=np.intp), np.arange(nx, dtype=np.intp)
    row, column = row + row // TILE_CELLS, column + column // TILE_CELLS
    apart = np.zeros((row[-1] + 1, column[-1] + 1), dtype=np.bool_)
    apart[np.ix_(row, column)] = closed
    labels = np.zeros(apart.shape, dtype=np.intp)  # From 1; 0 for open cells
    ndimage.label(apart, output=labels)
    labels = labels[np.ix_(row, column)]
    around = np.pad(labels, 1)
    columns = closed.shape[1] + 1
    sides: list[tuple[Indices, ...]] = []
    # Directions 0 to 3 (right, up, left, down) run below, right of, above and left of the cell.
    for direction, (neighbour, start, end) in enumerate(
        (
            (around[:-2, 1:-1], (0, 0), (0, 1)),
            (around[1:-1, 2:], (0, 1), (1, 1)),
            (around[2:, 1:-1], (1, 1), (1, 0)),
            (around[1:-1, :-2], (1, 0), (0, 0)),
        )
    ):
        row, column = np.nonzero(closed & (labels != neighbour))
        sides.append(
            (
                (row + start[0]) * columns + column + start[1],
                (row + end[0]) * columns + column + end[1],
                np.full(row.size, direction, dtype=np.intp),
                labels[row, column],
            )
        )
    start, end, direction, owner = (np.concatenate(side) for side in zip(*sides, strict=True))
    if start.size > MOST_EDGES:
        raise InputError(
            f"the outlines of the occupied cells have {start.size:,} edges, more than the "
            f"limit of {MOST_EDGES:,}",
            remedy="remove isolated cells from the map, or use larger cells",
        )
    key = 4 * start + direction
    by_key = np.argsort(key)
    left, ahead, right = (
        _found(key, by_key, 4 * end + (direction + turn) % 4) for turn in (1, 0, 3)
    )
    following = np.where(left >= 0, left, np.where(ahead >= 0, ahead, right))
    pinched = (left >= 0) & (right >= 0)
    pinched[pinched] = owner[right[pinched]] == owner[pinched]
    following[pinched] = right[pinched]
    place = np.column_stack([end % columns, end // columns])
    return _Edges(place, owner, following, direction[following] != direction)


def _found(key: Indices, by_key: Indices, wanted: Indices) -> Indices:
    """Return the index of each wanted key in `key`; -1 for a missing key."""
    at = by_key[np.minimum(np.searchsorted(key, wanted, sorter=by_key), key.size - 1)]
    return np.where(key[at] == wanted, at, -1)


def _polygons(closed: Mask, grid: OccupancyGrid) -> NDArray[np.object_]:
    """Return one polygon per component, with a corner at each turn of its outline."""
    edges = _edges(closed)
    order, first = _outlines(edges)
    corners = edges.end[order]
    ring = np.repeat(np.arange(first.size), np.diff(np.append(first, order.size)))
    following = np.arange(1, order.size + 1)
    following[np.append(first[1:], order.size) - 1] = first
    across = corners[:, 0] * corners[following, 1] - corners[following, 0] * corners[:, 1]
    # Integer areas have exact signs: positive for outlines, negative for holes.
    outer = np.bincount(ring, across) > 0.0
    component = edges.label[order[first]]
    rings = cast("NDArray[np.object_]", shapely.linearrings(grid.placed_m(corners), indices=ring))
    shells = rings[outer][np.argsort(component[outer])]
    polygons = cast("NDArray[np.object_]", shapely.polygons(shells))
    inner, of = rings[~outer], component[~outer] - 1
    by_component = np.argsort(of, kind="stable")
    bounds = np.flatnonzero(np.diff(of[by_component], prepend=-1, append=-1))
    for begin, stop in itertools.pairwise(bounds):
        holes = by_component[begin:stop]
        polygons[of[holes[0]]] = shapely.polygons(shells[of[holes[0]]], inner[holes])
    return polygons


def _outlines(edges: _Edges) -> tuple[Indices, Indices]:
    """Return the edges that end at turns, by outline, and where each outline starts in them."""
    turning = edges.following.copy()
    while (straight := ~edges.turns[turning]).any():
        # Pointer jumping: each round doubles the length of skipped straight runs.
        turning[straight] = turning[turning[straight]]
    after: list[int] = turning.tolist()
    done = bytearray(turning.size)
    order: list[int] = []
    first: list[int] = []
    for edge in np.flatnonzero(edges.turns).tolist():
        if not done[edge]:
            first.append(len(order))
        while not done[edge]:
            done[edge] = 1
            order.append(edge)
            edge = after[edge]
    return np.array(order, dtype=np.intp), np.array(first, dtype=np.intp)


LARGEST_YAML_BYTES = 64 * 1024

FEWER_CELLS = "crop the map to the area of interest, or use larger cells"

CSV_HEADER = ("resolution_m", "origin_x_m", "origin_y_m", "occupied_from")

IMAGES = {".pgm": "PPM", ".png": "PNG"}  # Pillow's names of image formats, by file extension

BYTE_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA")
DEEP_MODES = ("I", "I;16", "I;16B", "I;16L")
"""Pillow modes of 16-bit pixels; `BYTE_MODES` have 8-bit pixels."""
NO_TURN_RAD, LARGEST_YAW_RAD = 1e-9, 2.0 * math.pi
"""Yaw below which a map counts as not rotated, and above which it is probably in degrees."""
UNKNOWN_GREY = 205  # Grey value that ROS mapping packages write for unknown cells


def is_grid(path: Path | str | None) -> bool:
    """Return whether a path has the extension of an occupancy grid."""
    return path is not None and Path(path).suffix.lower() in GRID_READERS


def read_grid(path: Path | str) -> OccupancyGrid:
    """Return the occupancy grid in a file, read according to its extension.

    Parameters
    ----------
    path
        YAML file of a ROS or Nav2 map with its image next to it, or CSV file of a grid.

    Raises
    ------
    InputError
        The file cannot be read or is not such a map.
    """
    path = Path(path)
    if not is_grid(path):
        raise InputError(
            "is not the name of an occupancy grid",
            file=path,
            remedy="give a file that ends in .yaml, .yml or .csv",
        )
    try:
        return GRID_READERS[path.suffix.lower()](path)
    except InputError as error:
        raise error.located(path) from error.__cause__


def _read_ros_map(path: Path) -> OccupancyGrid:
    """Return the occupancy grid of a ROS map (YAML file and image)."""
    table = _yaml_table(path)
    side_m, (x, y, yaw) = _number(table, "resolution"), _origin(table)
    resolution, (x, y) = _placed(side_m, x, y)
    negate = _one_of(table, "negate", ("0", "1")) == "1"
    mode = _one_of(table, "mode", ("trinary", "scale", "raw"))
    if mode == "raw" and negate:
        raise InputError(
            "is 1 with mode raw, which ROS 1 and Nav2 interpret differently",
            key="negate",
            remedy="invert the image, and set negate: 0",
        )
    occupied_from = _number(table, "occupied_thresh")
    free_to = _number(table, "free_thresh")
    if not 0.0 <= free_to <= occupied_from <= 1.0:
        raise InputError(
            f"is {free_to:g} and occupied_thresh is {occupied_from:g}, should be 0 <= "
            "free_thresh <= occupied_thresh <= 1",
            key="free_thresh",
            remedy="write for instance free_thresh: 0.196 and occupied_thresh: 0.65",
        )
    image = table.get("image")
    if not isinstance(image, str) or not image:
        raise InputError(
            "is missing, or is not text", key="image", remedy="give the file name of the image"
        )
    shade, opaque = _shades(path.parent / image, raw=mode == "raw")
    if mode == "raw":
        per_cent = np.round(255.0 * shade)
        occupancy, known = per_cent / 100.0, opaque & (per_cent <= 100.0)
    else:
        occupancy, known = (shade if negate else 1.0 - shade), opaque
    occupied = known & (occupancy > occupied_from)
    free = known & (occupancy < free_to)
    grey = int((free & (np.round(255.0 * shade) == UNKNOWN_GREY)).sum()) if mode != "raw" else 0
    # The first image row has the largest y.
    return OccupancyGrid(occupied[::-1], ~(occupied | free)[::-1], resolution, (x, y), grey, yaw)


def _read_csv_grid(path: Path) -> OccupancyGrid:
    """Return the occupancy grid in a CSV file."""
    rows = csv_rows(path)
    nothing: tuple[int, list[str]] = (1, [])
    header, values = ([cell.strip() for cell in next(rows, nothing)[1]] for _ in range(2))
    if header != list(CSV_HEADER) or len(values) != len(CSV_HEADER):
        raise InputError(
            f"the first row should be {','.join(CSV_HEADER)}, and the second row its values",
            row=1,
            remedy=f"write {','.join(CSV_HEADER)}, then for instance 0.05,0,0,50, then the cells",
        )
    numbers = [_cell(text, 2, name) for text, name in zip(values, header, strict=True)]
    cells: list[list[float]] = []
    for line, row in rows:
        if cells and len(row) != len(cells[0]):
            raise InputError(
                f"the row has {len(row)} cells, but the first row has {len(cells[0])}",
                row=line,
                remedy="give all rows the same number of cells",
            )
        _require_cells((len(cells) + 1) * len(row))
        found = enumerate(row, start=1)
        cells.append([_cell(text, line, f"column {column}") for column, text in found])
    if not cells:
        raise InputError(
            "the grid has no cells", remedy="add the rows of cells after the first two rows"
        )
    resolution, origin = _placed(numbers[0], numbers[1], numbers[2])
    grid = np.array(cells)[::-1]
    unknown = ~(grid >= 0.0)
    return OccupancyGrid(~unknown & (grid >= numbers[3]), unknown, resolution, origin)


GRID_READERS: dict[str, Callable[[Path], OccupancyGrid]] = {
    ".yaml": _read_ros_map,
    ".yml": _read_ros_map,
    ".csv": _read_csv_grid,
}
"""Readers of occupancy grids by file extension."""


def _yaml_table(path: Path) -> dict[str, object]:
    """Return the top-level table of a YAML file with scalars as text; reject aliases."""
    import yaml

    text = read_text(path, LARGEST_YAML_BYTES)
    with foreign_reader(path, "a YAML file"):
        try:
            shared = (yaml.AliasToken, yaml.AnchorToken)
            scan = cast("Callable[..., Iterable[object]]", yaml.scan)  # pyright: ignore[reportUnknownMemberType]
            if any(isinstance(token, shared) for token in scan(text, yaml.BaseLoader)):
                raise InputError("contains YAML anchors or aliases", remedy="write out the values")
            table: object = yaml.load(text, yaml.BaseLoader)
        except yaml.MarkedYAMLError as error:
            row = None if error.problem_mark is None else error.problem_mark.line + 1
            raise InputError(
                f"is not YAML: {error.problem}",
                row=row,
                remedy="give the YAML file of a ROS map, or a CSV file of a grid",
            ) from error
    if not isinstance(table, dict):
        raise InputError(
            "contains no YAML keys", remedy="a ROS map has the keys image, resolution, origin, ..."
        )
    return cast("dict[str, object]", table)


def _number(table: dict[str, object], key: str) -> float:
    """Return the finite number at `key`."""
    value = table.get(key)
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(
            f"is {_shown(value)}, should be a finite number",
            key=key,
            remedy="write a number such as 0.05",
        )
    return number


def _shown(value: object) -> str:
    """Return a value formatted for a message."""
    text = "missing" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:60]}...{text[-1]}"


def _one_of(table: dict[str, object], key: str, allowed: tuple[str, ...]) -> str:
    """Return the word at `key`, which must be one of `allowed`; default: the first of them."""
    value = table.get(key, allowed[0])
    word = {"true": "1", "false": "0"}.get(str(value).lower(), value)
    if not isinstance(word, str) or word not in allowed:
        raise InputError(
            f"is {_shown(value)}, should be one of {', '.join(allowed)}",
            key=key,
            remedy="use one of these values",
        )
    return word


def _origin(table: dict[str, object]) -> tuple[float, float, float]:
    """Return x, y and yaw of the origin."""
    origin = table.get("origin")
    values = cast("list[object]", origin if isinstance(origin, list) else [])
    if len(values) not in (2, 3):
        raise InputError(
            f"is {_shown(table.get('origin'))}, should be [x, y, yaw]",
            key="origin",
            remedy="give metres and radians, e.g. [0.0, 0.0, 0.0]",
        )
    x, y, yaw = (_number({"origin": value}, "origin") for value in (*values, "0")[:3])
    if abs(yaw) > LARGEST_YAW_RAD:
        raise InputError(
            f"has a yaw of {yaw:g}, which is not an angle in radians",
            key="origin",
            remedy="write [x, y, yaw] with the yaw in radians",
        )
    return x, y, 0.0 if abs(yaw) <= NO_TURN_RAD else yaw


def _placed(resolution_m: float, x_m: float, y_m: float) -> tuple[float, tuple[float, float]]:
    """Return the validated resolution and origin, in metres."""
    if not 0.0 < resolution_m <= LARGEST_COORDINATE_M:
        raise InputError(
            f"is {resolution_m:g}, should be above 0",
            key="resolution",
            remedy="give the side of a cell in metres",
        )
    if not max(abs(x_m), abs(y_m)) <= LARGEST_COORDINATE_M:
        raise InputError(
            f"is ({x_m:g}, {y_m:g}), which is out of range",
            key="origin",
            remedy="give metres in the coordinate frame of world.bounds_m",
        )
    return resolution_m, (x_m, y_m)


def _shades(path: Path, raw: bool) -> tuple[Floats, Mask]:
    """Return the brightness of image pixels, from 0 to 1, and the mask of opaque pixels."""
    from PIL import Image

    kind = IMAGES.get(path.suffix.lower())
    if kind is None:
        raise InputError(
            "is an image in a format that is not supported",
            file=path,
            remedy="use a .pgm or .png image",
        )
    content = read_bytes(path)
    with foreign_reader(path, "an image"):
        try:
            image = Image.open(io.BytesIO(content), formats=[kind])
        except Image.DecompressionBombError:
            raise InputError(f"has more than {MOST_CELLS:,} cells", remedy=FEWER_CELLS) from None
        with image:
            _require_cells(image.width * image.height)
            if image.mode not in (*DEEP_MODES, *BYTE_MODES) or (raw and image.mode in DEEP_MODES):
                raise InputError(
                    f"has pixels of type {image.mode}, which are not supported",
                    remedy="save the image with 8-bit grey levels",
                )
            deep = image.mode in DEEP_MODES
            pixels = np.asarray(image if deep else image.convert("RGBA"))
    if deep:
        return pixels / 65535.0, np.ones(pixels.shape, dtype=np.bool_)
    return pixels[..., :3].sum(axis=-1, dtype=np.uint16) / 765.0, pixels[..., 3] == 255


def _require_cells(count: int) -> None:
    """Raise an InputError for a grid with too many cells or none."""
    if not 0 < count <= MOST_CELLS:
        raise InputError(
            f"has {count:,} cells, should have 1 to {MOST_CELLS:,}", remedy=FEWER_CELLS
        )


def _cell(text: str, row: int, key: str) -> float:
    """Return the number in a cell of a CSV file; NaN for an empty cell."""
    try:
        value = float(text) if text.strip() else math.nan
    except ValueError:
        value = math.inf
    if math.isinf(value) or (row == 2 and math.isnan(value)):
        raise InputError(
            f"{_shown(text)} is not a number",
            key=key,
            row=row,
            remedy="write 0 (free) to 100 (occupied), or -1 for unknown"
            if key.startswith("column ")
            else "write a finite number",
        )
    return value
