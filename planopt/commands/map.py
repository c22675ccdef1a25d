"""``planopt map``: radio map on a grid and masks for Nav2, from a power log or a problem."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import reduce
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from planopt.commands.fit import DEGENERATE, fit_each, fit_json
from planopt.commands.options import (
    JsonOption,
    LogOptions,
    option,
    progress,
    results_folders,
    say,
    show,
    with_options,
)
from planopt.errors import InputError
from planopt.files.writing import replaced_results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from planopt.channel.channel_map import Bounds, PosteriorMap
    from planopt.channel.measurements import Measurements
    from planopt.world.geodesy import Origin
    from planopt.world.nav2_masks import MaskLimits


@dataclass(frozen=True, eq=False)
class _Mapped:
    """Map of a log or a problem, with its channel fits."""

    maps: PosteriorMap
    fits: Sequence[dict[str, Any]]  # JSON of each station's fit
    exit_code: int
    draw: Callable[[], Figure]
    origin_deg: Origin | None = None
    p_min: float | None = None  # Required probability of the problem; None for a log


@dataclass(frozen=True, kw_only=True)
class MapOptions(LogOptions):
    """Options of the map of a log or a problem."""

    log: Annotated[
        Path,
        typer.Argument(
            metavar="LOG_OR_PROBLEM", help="Power log, problem file, or problem name from `list`."
        ),
    ]


@with_options(MapOptions)
def map_log(
    options: MapOptions,
    out: Annotated[
        Path | None, option("--out", "FILE", "File for the map: .csv, .npz, .nc or .tif.")
    ] = None,
    nav2: Annotated[
        Path | None, option("--nav2", "DIR", "Folder for the filter masks of Nav2.")
    ] = None,
    keepout_below: Annotated[
        float, option("--keepout-below", "P", "Keepout mask: forbid cells below this P(connected).")
    ] = 0.1,
    p_min: Annotated[
        float | None,
        option(
            "--p-min",
            "P",
            "Contact mask: least P(connected) in contact; default: the problem's p_min, or 0.9.",
        ),
    ] = None,
    cell: Annotated[
        float | None,
        option("--cell", "M", "Cell side in metres; default: 200 cells on the longer side."),
    ] = None,
    bounds: Annotated[
        str | None,
        option("--bounds", "X0,Y0,X1,Y1", "Bounds in metres; default: the measured area."),
    ] = None,
    threshold: Annotated[
        float | None,
        option(
            "--threshold",
            "DBM",
            "Minimum power of a connection; default: --floor, or the least power of the log.",
        ),
    ] = None,
    picture: Annotated[
        Path | None, option("--picture", "FILE", "Also draw the map; .png, .svg or .pdf.")
    ] = None,
    json: JsonOption = False,
) -> int:
    """Write a radio map of a log or a problem.

    Its layers are power, standard deviation and P(connected).

    The map of a log is for its first receiver, at the time of the latest measurement. The map of
    a problem covers its bounds and shows the best station at each position. --nav2 writes three
    filter masks: keepout, weighted and contact.
    """
    from planopt.channel.cholesky import one_blas_thread
    from planopt.world.nav2_masks import MaskLimits, write_masks
    from planopt.world.raster_files import check_raster_output

    if out is None and nav2 is None:
        raise InputError("no output is requested", remedy="give --out FILE or --nav2 DIR")
    if out is not None:
        check_raster_output(out)
    MaskLimits(keepout_below, 0.9 if p_min is None else p_min)
    box = None if bounds is None else parse_bounds(bounds)
    folders = [nav2, *(None if file is None else file.parent for file in (out, picture))]
    with results_folders(folders):
        with progress("mapping"), one_blas_thread():
            named = not options.log.suffix and (options.log.is_dir() or not options.log.exists())
            is_problem = named or options.log.suffix == ".toml"
            make = _problem_map if is_problem else _log_map
            found = make(options, box, cell, threshold)
        maps = found.maps
        with _together(out, picture) as (new_out, new_picture):
            if new_out is not None:
                maps.save(new_out, origin_deg=found.origin_deg)
            if new_picture is not None:
                from planopt.report import save_figure

                with progress("drawing"):
                    save_figure(found.draw(), new_picture)
        own = 0.9 if found.p_min is None else found.p_min
        limits = MaskLimits(keepout_below, own if p_min is None else p_min)
        if nav2 is not None:
            write_masks(nav2, maps.connectivity, limits)
    data = map_json(maps, out, picture)
    data["nav2"] = None if nav2 is None else _masks_json(nav2, maps, limits)
    data |= {"fit": found.fits[0]} if len(found.fits) == 1 else {"fits": list(found.fits)}
    show(json, data, _in_words(data, found.fits))
    return found.exit_code


def _log_map(
    options: LogOptions, bounds: Bounds | None, cell: float | None, threshold: float | None
) -> _Mapped:
    """Fit the channel of each transmitter in a log, and map the best one at each position."""
    from planopt.channel.channel_map import (
        default_cell_m,
        measured_bounds_m,
        posterior_map,
        serving_map,
    )
    from planopt.channel.measurements import join
    from planopt.channel.posterior import condition
    from planopt.world.geodesy import parse_origin

    fits, _ = fit_each(options)
    several = options.each is not None
    pooled = reduce(join, (each.measurements for each in fits.values()))
    box = measured_bounds_m(pooled) if bounds is None else bounds
    cell_m = default_cell_m(box) if cell is None else cell
    least = _threshold_dbm(threshold, options.floor, pooled)
    posteriors = [condition(each.found.parameters, each.measurements) for each in fits.values()]
    if several:
        maps = serving_map(posteriors, box, cell_m, [least] * len(posteriors))
        title = f"{options.log.name}: best of {len(fits)} transmitters"
    else:
        maps = posterior_map(posteriors[0], box, cell_m, least)
        method = fits[""].found.method
        title = f"{options.log.name}: {len(pooled)} measurements, {method} fit"

    def draw() -> Figure:
        from planopt.report import draw_posterior_map

        stations = [each.found.parameters.station for each in fits.values()]
        return draw_posterior_map(maps, pooled, stations, title)

    described = [
        fit_json(each) | ({"station": label} if several else {}) for label, each in fits.items()
    ]
    exit_code = max(each.exit_code for each in fits.values())
    origin_deg = None if options.origin is None else parse_origin(options.origin)
    return _Mapped(maps, described, exit_code, draw, origin_deg)


def _problem_map(
    options: LogOptions, bounds: Bounds | None, cell: float | None, threshold: float | None
) -> _Mapped:
    """Learn the channels of a problem's stations, and map the best one at each position."""
    from planopt.channel.channel_map import default_cell_m, serving_map
    from planopt.planning.initial_data import initial_belief
    from planopt.problems.load import load_motion
    from planopt.problems.plausibility import problem_warnings

    plain = LogOptions(log=options.log)
    given = [name for name, value in vars(options).items() if value != getattr(plain, name)]
    if given:
        raise InputError(
            f"is for logs, and {options.log.name} is a problem file",
            key=f"--{given[0].replace('_', '-')}",
            remedy="leave it out; the problem file has keys for it in channel.measurements",
        )
    problem = load_motion(options.log)
    for words in problem_warnings(problem):
        say(f"{problem.name}: {words}")
    belief = initial_belief(problem)
    box = problem.workspace.bounds_m if bounds is None else bounds
    thresholds = [
        station.threshold_dbm if threshold is None else threshold for station in problem.stations
    ]
    maps = serving_map(
        belief.posteriors, box, default_cell_m(box) if cell is None else cell, thresholds
    )
    learnt = [each.fit for each in (belief, *belief.further)]
    fits = [
        {
            "station": station.name,
            "method": fit.method,
            "status": fit.status,
            "measurements": fit.measurements,
            "censored": fit.censored,
            "warnings": list(fit.warnings),
        }
        for station, fit in zip(problem.stations, learnt, strict=True)
    ]

    def draw() -> Figure:
        from planopt.report import draw_belief

        return draw_belief(problem, belief)

    is_degenerate = any(fit.status == "degenerate" for fit in learnt)
    p_min = problem.constraints.p_min or None
    origin_deg = problem.channel.origin_deg
    return _Mapped(maps, fits, DEGENERATE if is_degenerate else 0, draw, origin_deg, p_min)


def _masks_json(folder: Path, maps: PosteriorMap, limits: MaskLimits) -> dict[str, Any]:
    """Return the JSON object of the masks: their limits and shares of filtered cells."""
    from planopt.world.nav2_masks import MASKS, mask_values

    values = mask_values(maps.connectivity.values, limits)
    return {
        "folder": str(folder),
        "masks": [f"{name}.yaml" for name in MASKS],
        "keepout_below": limits.keepout_below,
        "p_min": limits.contact_from,
        "keepout_share": float((values["keepout"] > 0).mean()),
        "mean_weight": float(values["weighted"].mean()),
        "contact_share": float((values["contact"] > 0).mean()),
    }


def parse_bounds(text: str) -> Bounds:
    """Parse ``X0,Y0,X1,Y1`` in metres."""
    try:
        x_min, y_min, x_max, y_max = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f"cannot read {text!r}",
            key="--bounds",
            remedy="write X_MIN,Y_MIN,X_MAX,Y_MAX in metres",
        ) from None
    return x_min, y_min, x_max, y_max


def map_json(maps: PosteriorMap, out: Path | None, picture: Path | None) -> dict[str, Any]:
    """Return the JSON object of ``planopt map`` that describes the map."""
    from planopt.channel.channel_map import MAP_VARIABLES

    raster = maps.mean_db
    return {
        "file": None if out is None else str(out),
        "picture": None if picture is None else str(picture),
        "variables": list(MAP_VARIABLES),
        "shape": list(raster.values.shape),
        "cell_m": raster.cell_m[0],
        "x_m": [float(raster.x_m[0]), float(raster.x_m[-1])],
        "y_m": [float(raster.y_m[0]), float(raster.y_m[-1])],
        "threshold_dbm": maps.threshold_dbm,
        "connected_share": float((maps.connectivity.values >= 0.5).mean()),
        "posterior": maps.posterior,
    }


def _threshold_dbm(
    threshold: float | None, floor: float | None, measurements: Measurements
) -> float:
    """Return the required threshold, by default the weakest power in the log."""
    if threshold is not None:
        return threshold
    return float(measurements.power_dbm.min()) if floor is None else floor


@contextlib.contextmanager
def _together(out: Path | None, picture: Path | None) -> Generator[tuple[Path | None, Path | None]]:
    """Yield temporary names of map and figure; on exit, move both into place."""
    files = [file for file in (out, picture) if file is not None]
    with contextlib.ExitStack() as stack:
        staged: dict[Path, Path] = {}
        for folder in dict.fromkeys(file.parent for file in files):
            names = tuple(escape(file.name) for file in files if file.parent == folder)
            staged[folder] = stack.enter_context(replaced_results(folder, names))

        def new(file: Path | None) -> Path | None:
            return None if file is None else staged[file.parent] / file.name

        yield new(out), new(picture)


def _in_words(data: dict[str, Any], fits: Sequence[dict[str, Any]]) -> str:
    rows, columns = data["shape"]
    (x_min, x_max), (y_min, y_max) = data["x_m"], data["y_m"]
    named = "map" if data["file"] is None else data["file"]
    lines = [
        f"{named}: {rows} x {columns} cells of {data['cell_m']:g} m, "
        f"x from {x_min:g} to {x_max:g} m, y from {y_min:g} to {y_max:g} m"
    ]
    for fit in fits:
        station = f"{fit['station']}: " if isinstance(fit["station"], str) else ""
        lines.append(
            f"  {station}from {fit['measurements']} measurements, {fit['censored']} of them "
            f"upper limits; channel fit: {fit['status']}; posterior: {data['posterior']}"
        )
    lines.append(
        f"  P(power at least {data['threshold_dbm']:g} dBm) is 0.5 or more in "
        f"{100.0 * data['connected_share']:.1f} % of the cells"
    )
    lines += [f"  {warning}" for fit in fits for warning in fit["warnings"]]
    if data["picture"] is not None:
        lines.append(f"  picture: {data['picture']}")
    if data["nav2"] is not None:
        masks = data["nav2"]
        lines += [
            f"{masks['folder']}: Nav2 masks {', '.join(masks['masks'])}; parameters "
            "nav2_filters.yaml",
            f"  keepout: P(connected) is below {masks['keepout_below']:g} in "
            f"{100.0 * masks['keepout_share']:.1f} % of the cells"
            + ("" if masks["keepout_share"] else ": nothing is forbidden (raise --keepout-below)"),
            f"  contact: P(connected) is at least {masks['p_min']:g} in "
            f"{100.0 * masks['contact_share']:.1f} % of the cells",
            f"  next: ros2 launch {masks['folder']}/nav2_filters.launch.py",
        ]
    return "\n".join(lines)
