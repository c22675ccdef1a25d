"""Occupancy grids from files: maps of ROS (YAML with a PGM or PNG image), and CSV.

ROS: ``image``, ``resolution`` (metres a pixel), ``origin`` ([x, y, yaw] of the lower left corner),
``occupied_thresh``, ``free_thresh``, ``negate`` (0) and ``mode`` (trinary) are those of
``map_server`` and Nav2. The occupancy of a pixel is its darkness from 0 to 1, with ``negate`` its
brightness. Above ``occupied_thresh`` its cell is occupied, below ``free_thresh`` free, between them
unknown, also in mode ``scale``. In ``raw`` the pixel is its occupancy in per cent, and unknown
above 100. A pixel that is not opaque is unknown.

CSV: a row of names ``resolution_m,origin_x_m,origin_y_m,occupied_from``, a row of their values, and
then the rows of the map, that of the largest y first. Cells of at least
``occupied_from`` are occupied; negative and empty ones are unknown; the others are free.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.reading import csv_rows, foreign_reader, read_bytes, read_text
from planopt.keys import LARGEST_COORDINATE_M
from planopt.world.occupancy_grid import MOST_CELLS, OccupancyGrid

LARGEST_YAML_BYTES = 64 * 1024

FEWER_CELLS = "cut the map to what is needed, or use larger cells"

CSV_HEADER = ("resolution_m", "origin_x_m", "origin_y_m", "occupied_from")

IMAGES = {".pgm": "PPM", ".png": "PNG"}
"""Formats of images by ending, as Pillow calls them."""

BYTE_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA")
DEEP_MODES = ("I", "I;16", "I;16B", "I;16L")
"""Pixels of 8 and of 16 bits, as Pillow calls them."""

NO_TURN_RAD = 1e-9

UNKNOWN_GREY = 205
"""Grey that ROS mapping packages write for unknown cells."""


def is_grid(path: Path | str | None) -> bool:
    """Return whether a file is an occupancy grid, by the ending of its name."""
    return path is not None and Path(path).suffix.lower() in GRID_READERS


def read_grid(path: Path) -> OccupancyGrid:
    """Read an occupancy grid, by the ending of its file."""
    try:
        return GRID_READERS[path.suffix.lower()](path)
    except InputError as error:
        raise error.located(path) from error.__cause__


def _read_ros_map(path: Path) -> OccupancyGrid:
    """Read a map of ROS."""
    table = _yaml_table(path)
    resolution, (x, y) = _placed(_number(table, "resolution"), *_origin(table))
    negate = _one_of(table, "negate", ("0", "1")) == "1"
    mode = _one_of(table, "mode", ("trinary", "scale", "raw"))
    if mode == "raw" and negate:
        raise InputError(
            "is 1 with mode raw, which ROS 1 and Nav2 read differently",
            key="negate",
            remedy="invert the image and set negate: 0",
        )
    occupied_from = _number(table, "occupied_thresh")
    free_to = _number(table, "free_thresh")
    if not 0.0 <= free_to <= occupied_from <= 1.0:
        raise InputError(
            f"{free_to:g} and occupied_thresh {occupied_from:g} are not 0 <= free <= occupied <= 1",
            key="free_thresh",
            remedy="give free_thresh: 0.196 and occupied_thresh: 0.65, for instance",
        )
    image = table.get("image")
    if not isinstance(image, str) or not image:
        raise InputError("is missing or no text", key="image", remedy="name the image")
    shade, opaque = _shades(path.parent / image, raw=mode == "raw")
    if mode == "raw":
        per_cent = np.round(255.0 * shade)
        occupancy, known = per_cent / 100.0, opaque & (per_cent <= 100.0)
    else:
        occupancy, known = (shade if negate else 1.0 - shade), opaque
    occupied = known & (occupancy > occupied_from)
    free = known & (occupancy < free_to)
    grey = int((free & (np.round(255.0 * shade) == UNKNOWN_GREY)).sum()) if mode != "raw" else 0
    # The first row of an image is its top.
    return OccupancyGrid(occupied[::-1], ~(occupied | free)[::-1], resolution, (x, y), grey)


def _read_csv_grid(path: Path) -> OccupancyGrid:
    """Read a grid as CSV."""
    rows = csv_rows(path)
    nothing: tuple[int, list[str]] = (1, [])
    header, values = ([cell.strip() for cell in next(rows, nothing)[1]] for _ in range(2))
    if header != list(CSV_HEADER) or len(values) != len(CSV_HEADER):
        raise InputError(
            f"the first two rows are not {','.join(CSV_HEADER)} and their values",
            row=1,
            remedy="put both above the cells, which alone do not say where they are: "
            f"{','.join(CSV_HEADER)}, then for instance 0.05,0,0,50",
        )
    numbers = [_cell(text, 2, name) for text, name in zip(values, header, strict=True)]
    cells: list[list[float]] = []
    for line, row in rows:
        if cells and len(row) != len(cells[0]):
            raise InputError(
                f"{len(row)} cells where the first row has {len(cells[0])}",
                row=line,
                remedy="give each row as many cells",
            )
        _require_cells((len(cells) + 1) * len(row))
        found = enumerate(row, start=1)
        cells.append([_cell(text, line, f"column {column}") for column, text in found])
    if not cells:
        raise InputError("there are no cells", remedy="rows of cells follow the values")
    resolution, origin = _placed(numbers[0], numbers[1], numbers[2])
    grid = np.array(cells)[::-1]
    unknown = ~(grid >= 0.0)
    return OccupancyGrid(~unknown & (grid >= numbers[3]), unknown, resolution, origin)


GRID_READERS: dict[str, Callable[[Path], OccupancyGrid]] = {
    ".yaml": _read_ros_map,
    ".yml": _read_ros_map,
    ".csv": _read_csv_grid,
}
"""Readers of occupancy grids, by the ending of the file."""


def _yaml_table(path: Path) -> dict[str, object]:
    """Return the keys of a YAML file; all scalars are text, and aliases are refused."""
    import yaml

    text = read_text(path, LARGEST_YAML_BYTES)
    with foreign_reader(path, "a YAML file"):
        try:
            shared = (yaml.AliasToken, yaml.AnchorToken)
            scan = cast("Callable[..., Iterable[object]]", yaml.scan)  # pyright: ignore[reportUnknownMemberType]
            if any(isinstance(token, shared) for token in scan(text, yaml.BaseLoader)):
                raise InputError("has anchors or aliases", remedy="write the values out")
            table: object = yaml.load(text, yaml.BaseLoader)
        except yaml.MarkedYAMLError as error:
            row = None if error.problem_mark is None else error.problem_mark.line + 1
            raise InputError(
                f"is not YAML: {error.problem}",
                row=row,
                remedy="give the YAML file of a ROS map, or a CSV file of a grid",
            ) from error
    if not isinstance(table, dict):
        raise InputError("has no keys", remedy="a map of ROS has image, resolution, origin, ...")
    return cast("dict[str, object]", table)


def _number(table: dict[str, object], key: str) -> float:
    """Return the number at `key`."""
    value = table.get(key)
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(
            f"is {_shown(value)}, should be a number", key=key, remedy="write a number"
        )
    return number


def _shown(value: object) -> str:
    """Return a value as a message shows it."""
    text = "missing" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:60]}..."


def _one_of(table: dict[str, object], key: str, allowed: tuple[str, ...]) -> str:
    """Return one of the allowed words at `key`, the first if it is missing."""
    value = table.get(key, allowed[0])
    word = {"true": "1", "false": "0"}.get(str(value).lower(), value)
    if not isinstance(word, str) or word not in allowed:
        raise InputError(
            f"is {_shown(value)}, should be one of {', '.join(allowed)}",
            key=key,
            remedy="write one of these",
        )
    return word


def _origin(table: dict[str, object]) -> tuple[float, float]:
    """Return x and y of the origin, whose yaw must be 0."""
    origin = table.get("origin")
    values = cast("list[object]", origin if isinstance(origin, list) else [])
    if len(values) not in (2, 3):
        raise InputError(
            f"is {_shown(table.get('origin'))}, should be [x, y, yaw]",
            key="origin",
            remedy="give metres and radians, such as [0.0, 0.0, 0.0]",
        )
    x, y, yaw = (_number({"origin": value}, "origin") for value in (*values, "0")[:3])
    if abs(yaw) > NO_TURN_RAD:
        raise InputError(
            f"has a yaw of {yaw:g} rad, and turned maps are not read",
            key="origin",
            remedy="turn the image until its yaw is 0",
        )
    return x, y


def _placed(resolution_m: float, x_m: float, y_m: float) -> tuple[float, tuple[float, float]]:
    """Return side and origin, which must be metres."""
    if not 0.0 < resolution_m <= LARGEST_COORDINATE_M:
        raise InputError(f"cells of {resolution_m:g} m", key="resolution", remedy="metres above 0")
    if not max(abs(x_m), abs(y_m)) <= LARGEST_COORDINATE_M:
        raise InputError(
            f"({x_m:g}, {y_m:g}) is no place in metres",
            key="origin",
            remedy="give metres near those of world.bounds_m",
        )
    return resolution_m, (x_m, y_m)


def _shades(path: Path, raw: bool) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the brightness of the pixels of an image, from 0 to 1, and which are opaque."""
    from PIL import Image

    kind = IMAGES.get(path.suffix.lower())
    if kind is None:
        raise InputError(
            f"images ending in {path.suffix!r} are not read", file=path, remedy="use .pgm or .png"
        )
    content = read_bytes(path)
    with foreign_reader(path, "an image"):
        try:
            image = Image.open(io.BytesIO(content), formats=[kind])
        except Image.DecompressionBombError:
            raise InputError(
                f"declares far more than {MOST_CELLS:,} cells", remedy=FEWER_CELLS
            ) from None
        with image:
            _require_cells(image.width * image.height)
            if image.mode not in (*DEEP_MODES, *BYTE_MODES) or (raw and image.mode in DEEP_MODES):
                raise InputError(
                    f"pixels of kind {image.mode} are not read", remedy="use 8 bit grey"
                )
            deep = image.mode in DEEP_MODES
            pixels = np.asarray(image if deep else image.convert("RGBA"))
    if deep:
        return pixels / 65535.0, np.ones(pixels.shape, dtype=np.bool_)
    return pixels[..., :3].sum(axis=-1, dtype=np.uint16) / 765.0, pixels[..., 3] == 255


def _require_cells(count: int) -> None:
    """Refuse a grid of too many cells, or of none."""
    if not 0 < count <= MOST_CELLS:
        raise InputError(
            f"has {count:,} cells, should have 1 to {MOST_CELLS:,}",
            remedy=FEWER_CELLS,
        )


def _cell(text: str, row: int, key: str) -> float:
    """Return a number of a CSV file."""
    try:
        value = float(text) if text.strip() else math.nan
    except ValueError:
        value = math.inf
    if math.isinf(value) or (row == 2 and math.isnan(value)):
        raise InputError(
            f"{_shown(text)} is not a number",
            key=key,
            row=row,
            remedy="write numbers from 0 (free) to 100 (occupied), -1 where it is not known",
        )
    return value
