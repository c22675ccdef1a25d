"""HTML page of a result: its content as data, and the self-contained file.

Plotly draws map and charts; the page contains it. Texts from files are escaped here for HTML, and
for the markup that Plotly accepts in labels.
"""

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import import_module
from importlib.resources import files
from importlib.util import find_spec
from typing import Any, cast

import numpy as np
import shapely

from planopt.arrays import Floats
from planopt.errors import InputError
from planopt.report.maps import joined
from planopt.report.panel import BLACK, colour_of
from planopt.world.motion import centres_at
from planopt.world.raster import Raster
from planopt.world.workspace import MovingObstacle, Obstacle

PAGE_FILE = "report.html"

SYMBOLS = ("circle", "square", "diamond", "triangle-down", "cross", "x", "hexagon")
"""Symbols of robots; their number differs from that of colours, so that pairs repeat late."""
MOST_NAMED = 8
"""Maximum number of robots with individual colours and legend entries; more are grouped by role."""
MOST_ROWS = 400  # Maximum number of rows of a table on the page
METRE_DIGITS, POWER_DIGITS, PROBABILITY_DIGITS = 3, 2, 4  # Decimal places of values in the page
EDGE_MARGIN = 0.05  # Margin around paths and obstacles, as a share of the longer side

_SLOT = re.compile(r"@@(\w+)@@")


@dataclass(frozen=True, eq=False)
class Layer:
    """Raster layer of the map."""

    name: str
    unit: str
    colours: str  # Colour scale of Plotly
    raster: Raster
    limits: tuple[float, float] | None = None
    mark: float | None = None  # Value whose contour is drawn

    @property
    def digits(self) -> int:
        """Return the number of decimal places of the values."""
        return POWER_DIGITS if self.limits is None else PROBABILITY_DIGITS


@dataclass(frozen=True, eq=False)
class Track:
    """Path of a robot, evader, agent or target over the steps of a result."""

    name: str
    t_s: Floats  # (n + 1,)
    positions_m: Floats  # (n + 1, 2)
    role: str = "robot"
    plans: Sequence[Floats] = ()  # (k, 2) by step; a single plan holds for all steps
    notes: Sequence[str] = ()  # Text by step


@dataclass(frozen=True, eq=False)
class PageMap:
    """Map with a time slider."""

    tracks: Sequence[Track]
    obstacles: Sequence[Obstacle] = ()
    moving: Sequence[MovingObstacle] = ()
    layers: Sequence[Layer] = ()
    places: Sequence[Mapping[str, Any]] = ()  # Name, x, y, colour and symbol of marked positions
    window: tuple[float, float, float, float] | None = None  # Rectangle shown first

    @property
    def times_s(self) -> Floats:
        """Return the times of the longest track, one per position of the slider."""
        return max((track.t_s for track in self.tracks), key=len)


Trace = Mapping[str, Any]
"""Points, line or bars of a Plotly chart, with escaped texts."""


@dataclass(frozen=True, eq=False)
class Chart:
    """Plotly chart: traces and layout."""

    title: str
    traces: Sequence[Trace]
    x: str
    y: str
    over_time: bool = False  # Whether a line marks the time of the slider
    layout: Mapping[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True, eq=False)
class PageTable:
    """Table of the page, with the shown `rows` and the `total` number of rows."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[object]]
    total: int = 0
    file: str = ""  # File with all rows


@dataclass(frozen=True, eq=False)
class Page:
    """Content of the page of a result."""

    title: str
    description: str
    words: Sequence[str]
    certificate: Sequence[str] = ()
    map: PageMap | None = None
    charts: Sequence[Chart] = ()
    tables: Sequence[PageTable] = ()


def page_html(page: Page) -> str:
    """Return the page as one HTML file; raise an `InputError` if Plotly is not installed."""
    if find_spec("plotly") is None:
        raise InputError("the page needs Plotly", remedy="pip install 'planopt[report]'")
    plotly = cast("Any", import_module("plotly.offline"))
    charts, figures = list[dict[str, Any]](), list[str]()
    for number, chart in enumerate(page.charts):
        layout = {
            **chart.layout,
            "xaxis": {"title": {"text": chart.x}, **chart.layout.get("xaxis", {})},
            "yaxis": {"title": {"text": chart.y}, **chart.layout.get("yaxis", {})},
        }
        charts.append({"traces": chart.traces, "layout": layout, "over_time": chart.over_time})
        name = f"chart{number}"
        figures.append(
            f'<figure><figcaption id="{name}title">{escape(chart.title)}</figcaption>\n'
            f'<div class="chart" id="{name}" role="img" aria-labelledby="{name}title">'
            "</div></figure>"
        )
    content = {"map": None if page.map is None else _map_json(page.map), "charts": charts}
    script = json.dumps(content, allow_nan=False, separators=(",", ":"))
    for sign in "<>&":  # No part of the data may end the script element
        script = script.replace(sign, f"\\u{ord(sign):04x}")
    lines = "\n".join(page.certificate)
    certificate = f'<h2 id="certificate">Certificate</h2>\n<pre>{escape(lines)}</pre>'
    slots = {
        "title": escape(page.title),
        "description": escape(page.description),
        "words": escape("\n".join(page.words)),
        "certificate": certificate if page.certificate else "",
        "map": "" if page.map is None else _template("page_map.html"),
        "charts": "\n".join(figures),
        "tables": "\n".join(map(_table_html, page.tables)),
        "content": script,
        "plotly": plotly.get_plotlyjs(),
        "script": _template("page.js"),
    }
    return _SLOT.sub(lambda slot: slots[slot[1]], _template("page.html"))


def plain(text: object) -> str:
    """Escape a text for labels of Plotly, which accept some HTML."""
    return escape(str(text), quote=False)


def scatter(name: str, x: list[Any], y: list[Any], mode: str = "markers", **look: Any) -> Trace:
    """Return points or a line for Plotly; values are rounded numbers, None, or escaped texts."""
    return {"type": "scatter", "mode": mode, "name": plain(name), "x": x, "y": y, **look}


def rounded(values: Iterable[float] | Floats, digits: int) -> list[Any]:
    """Return rounded numbers as nested lists, with None for NaN and infinities."""
    numbers = np.asarray(values, dtype=np.float64)
    kept = np.round(numbers, digits).astype(object)
    kept[~np.isfinite(numbers)] = None
    return kept.tolist()


def _template(name: str) -> str:
    return (files("planopt.report") / name).read_text(encoding="utf-8")


def _map_json(drawn: PageMap) -> dict[str, Any]:
    """Return the data of the map."""
    times_s = drawn.times_s
    lasting = joined([one.polygon for one in drawn.obstacles if not one.is_timed])
    timed = [one for one in drawn.obstacles if one.is_timed]
    window = drawn.window
    if window is None:
        outlines = [shapely.get_coordinates(one.polygon) for one in drawn.obstacles]
        points = np.concatenate([*(track.positions_m for track in drawn.tracks), *outlines])
        low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
        margin = EDGE_MARGIN * max(float((high - low).max()), 1.0)
        window = (*(low - margin).tolist(), *(high + margin).tolist())
    return {
        "times": rounded(times_s, METRE_DIGITS),
        "layers": [
            {
                "name": layer.name,
                "unit": layer.unit,
                "colours": layer.colours,
                "x": rounded(layer.raster.x_m, METRE_DIGITS),
                "y": rounded(layer.raster.y_m, METRE_DIGITS),
                "z": rounded(layer.raster.values, layer.digits),
                "limits": layer.limits,
                "mark": layer.mark,
            }
            for layer in drawn.layers
        ],
        "obstacles": [
            *([{"name": "obstacles", **_outlines(lasting)}] if lasting else []),
            *(
                {
                    "name": f"{one.name} (temporary)",
                    "from": one.known_from_s,
                    "until": None if math.isinf(one.until_s) else one.until_s,
                    **_outlines([one.polygon]),
                }
                for one in timed
            ),
        ],
        "moving": [
            {
                "name": f"{one.name} (moving obstacle)",
                "radius": one.radius_m,
                **_points(centres_at(one, times_s)),
            }
            for one in drawn.moving
        ],
        "places": list(drawn.places),
        "groups": _groups(drawn.tracks),
        "window": window,
    }


def _groups(tracks: Sequence[Track]) -> list[dict[str, Any]]:
    """Return tracks grouped by legend entry: one per track, or one per role if there are many."""
    named = len(tracks) <= MOST_NAMED
    groups: dict[str, list[Track]] = {}
    for number, track in enumerate(tracks):
        name = f"{number} {track.name}" if named else track.role
        groups.setdefault(name, []).append(track)
    found: list[dict[str, Any]] = []
    for number, members in enumerate(groups.values()):
        target = members[0].role in ("target", "event")
        found.append(
            {
                "name": members[0].name if named else f"{members[0].role}s",
                "colour": BLACK if target else colour_of(number),
                "symbol": "star" if target else SYMBOLS[number % len(SYMBOLS)],
                "tracks": [
                    {
                        **_points(track.positions_m),
                        "plans": [_points(plan) for plan in track.plans],
                        "notes": list(track.notes) if named else [],
                    }
                    for track in members
                ],
            }
        )
    return found


def _points(points_m: Floats) -> dict[str, list[Any]]:
    x, y = np.asarray(points_m, dtype=np.float64).reshape(-1, 2).T
    return {"x": rounded(x, METRE_DIGITS), "y": rounded(y, METRE_DIGITS)}


def _outlines(polygons: Sequence[shapely.Polygon]) -> dict[str, list[Any]]:
    """Return the rings of polygons, separated by None; holes have the opposite orientation."""
    gap = np.full((1, 2), np.nan)
    rings = shapely.get_rings([polygon.normalize() for polygon in polygons])
    parts = [part for ring in rings for part in (shapely.get_coordinates(ring), gap)]
    return _points(np.concatenate(parts))


def _table_html(table: PageTable) -> str:
    """Return an HTML table with caption and header cells, in a section that keys can expand."""
    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in table.header)
    body = "\n".join(
        "<tr>" + "".join(f"<td>{escape(cell_text(value))}</td>" for value in row) + "</tr>"
        for row in table.rows
    )
    hidden = table.total - len(table.rows)
    where = f" The others are in {table.file}." if table.file else ""
    note = f"The first {len(table.rows)} of {table.total} rows.{where}" if hidden > 0 else ""
    opened = " open" if len(table.rows) <= MOST_ROWS // 10 else ""
    title = escape(table.title)
    return (
        f"<details{opened}><summary>{title}</summary>"
        f'<div class="scroll" tabindex="0" role="region" aria-label="{title}">\n'
        f"<table><caption>{title}. {escape(note)}</caption>\n<thead><tr>{head}</tr></thead>\n"
        f"<tbody>\n{body}\n</tbody></table></div></details>"
    )


def cell_text(value: object) -> str:
    """Return the text of a table cell; empty for None and non-finite numbers."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}" if math.isfinite(value) else ""
    return str(value)
