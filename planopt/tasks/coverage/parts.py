"""Densities, starting positions, demands and radio links built from problem-file tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planopt.channel import (
    ChannelParameters,
    ChannelPosterior,
    LogFormat,
    Measurements,
    Station,
    condition,
    fit_channel,
    measure,
    model_truth,
    read_log,
)
from planopt.coverage.assignment import (
    Demand,
    accuracy_demand,
    capped_demand,
    table_demand,
    trade_off_demand,
)
from planopt.coverage.density import Density, GaussianMixture, RasterDensity, UniformDensity
from planopt.coverage.geodesic import Ground
from planopt.coverage.limits import LinkLaw, RadioLimits, StationMap, station_map
from planopt.coverage.localisation import EventSensor
from planopt.errors import InputError
from planopt.tasks.coverage.tables import (
    AccuracyTable,
    AgentsTable,
    CapTable,
    DemandTable,
    DensityTable,
    GaussiansTable,
    GridTable,
    NumberTable,
    PlacesTable,
    RadioTable,
    SurveyTable,
    TableDemandTable,
    UniformTable,
)
from planopt.world.raster import checked_raster
from planopt.world.raster_files import read_raster

CELLS = 8
"""Number of cells of a simulated channel per decorrelation distance."""

MOST_CELLS = 1_000_000
"""Maximum number of cells of a simulated channel."""

DRAWN = 400
"""Number of positions drawn for random starts, in addition to four per agent."""

START_SPARE = 0.1
"""Least gap between bodies at random starts, as a share of their radius."""

Floats = NDArray[np.float64]


def density_of(table: DensityTable, folder: Path) -> Density:
    """Return the density that a table describes; its file is relative to `folder`."""
    if isinstance(table, UniformTable):
        return UniformDensity(table.weight_per_m2)
    if isinstance(table, GaussiansTable):
        stds = np.array([each.std_m for each in table.bumps])
        weights = np.array([each.weight for each in table.bumps])
        means = np.array([each.mean_m for each in table.bumps])
        return GaussianMixture(weights, means, stds, table.floor_per_m2)
    if table.file is not None:
        return RasterDensity(read_raster(folder / table.file, table.variable))
    if table.values is None or len({len(row) for row in table.values}) != 1:
        raise InputError("has neither file nor values of rows of one length", key="density.values")
    x, y = (np.array(each or [], dtype=np.float64) for each in (table.x_m, table.y_m))
    return RasterDensity(checked_raster(x, y, np.array(table.values), "density"))


def demand_of(
    table: DemandTable, key: str, sensor: EventSensor, area_m2: float, agents: int
) -> Demand:
    """Return the demand that a table describes; raise if the agents cannot meet it."""
    if isinstance(table, NumberTable):
        if table.agents > agents:
            raise InputError(
                f"requires {table.agents} agents, there are {agents}",
                key=f"{key}.agents",
                remedy="give more agents, or require fewer",
            )
        return lambda count: min(table.agents, count)
    if isinstance(table, TableDemandTable):
        for number, step in enumerate(table.steps):
            if step.respond > step.at_least:
                raise InputError(
                    f"requires {step.respond} of {step.at_least} agents",
                    key=f"{key}.steps[{number}].respond",
                    remedy="require at most at_least",
                )
        return table_demand({each.at_least: each.respond for each in table.steps})
    if isinstance(table, CapTable):
        if table.remaining >= agents:
            raise InputError(
                f"keeps {table.remaining} agents from answering, there are {agents}",
                key=f"{key}.remaining",
                remedy="give more agents, or keep fewer",
            )
        return capped_demand(table.share, table.most, table.remaining)
    if isinstance(table, AccuracyTable):
        demand = accuracy_demand(sensor, table.accuracy_m, table.measurements)
        if demand(10**9) > agents:
            raise InputError(
                f"needs {demand(10**9)} agents, there are {agents}",
                key=f"{key}.accuracy_m",
                remedy="give more agents, or a larger error",
            )
        return demand
    return trade_off_demand(
        area_m2, table.localisation_m2, table.coverage_weight, table.localisation_weight
    )


def starts_of(table: AgentsTable, ground: Ground, generator: np.random.Generator) -> Floats:
    """Return the starting positions ``(n, 2)`` of the agents."""
    start, body_m = table.start, table.body_radius_m
    if isinstance(start, PlacesTable):
        return np.array(start.places_m)
    if isinstance(start, GridTable):
        x0, y0, x1, y1 = start.within_m
        x = x0 + (x1 - x0) * (np.arange(start.columns) + 0.5) / start.columns
        y = y0 + (y1 - y0) * (np.arange(start.rows) + 0.5) / start.rows
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    low, high = ground.hull.corners_m.min(axis=0), ground.hull.corners_m.max(axis=0)
    if start.within_m is not None:
        low, high = np.array(start.within_m[:2]), np.array(start.within_m[2:])
    drawn = low + (high - low) * generator.random((DRAWN + 4 * start.count, 2))
    found = drawn[has_room(ground, drawn, body_m)]
    if body_m > 0.0:
        found = found[_spread(found, (2.0 + START_SPARE) * body_m, start.count)]
    if len(found) < start.count:
        raise InputError(
            f"only {len(found)} of {start.count} agents found a free position",
            key="agents.start.within_m",
            remedy="give a larger free area" + (", or smaller bodies" if body_m > 0.0 else ""),
        )
    return found[: start.count]


def has_room(ground: Ground, places_m: Floats, body_radius_m: float) -> NDArray[np.bool_]:
    """Return whether bodies at positions ``(k, 2)`` are inside the ground; (k,).

    The clearance is already part of a geodesic ground, but not of a convex one.
    """
    inside = ground.allows(places_m)
    if body_radius_m == 0.0:
        return inside
    return inside & (ground.hull.excess_m(places_m) <= 1e-9 - body_radius_m)


def _spread(places_m: Floats, apart_m: float, most: int) -> list[int]:
    """Select at most `most` positions greedily such that all are at least `apart_m` apart."""
    chosen: list[int] = []
    for number, place in enumerate(places_m):
        if len(chosen) == most:
            break
        if (((places_m[chosen] - place) ** 2).sum(axis=1) >= apart_m**2).all():
            chosen.append(number)
    return chosen


def radio_of(table: RadioTable, mapped: StationMap | None) -> RadioLimits:
    """Return the radio requirement; links to stations follow the map if it is not None."""
    spread = np.diag([table.k_pl_std_db**2, table.n_pl_std**2])
    law = LinkLaw(np.array([table.k_pl_db, table.n_pl]), table.deviation_db, spread)
    stations = np.array(table.stations_m)
    return RadioLimits(stations, mapped or law, law, table.threshold_dbm, table.p_min)


def station_map_of(table: RadioTable, ground: Ground, folder: Path) -> StationMap | None:
    """Return the map estimated from the surveys of a table; None without surveys."""
    if not table.survey:
        return None
    if len(table.survey) != len(table.stations_m):
        raise InputError(
            f"has {len(table.survey)} entries for {len(table.stations_m)} stations",
            key="radio.survey",
            remedy="give one for each station, in their order",
        )
    low, high = ground.hull.corners_m.min(axis=0), ground.hull.corners_m.max(axis=0)
    bounds = float(low[0]), float(low[1]), float(high[0]), float(high[1])
    posteriors: list[ChannelPosterior] = []
    for number, (survey, place) in enumerate(zip(table.survey, table.stations_m, strict=True)):
        station = Station(place)
        try:
            measured = _measured(survey, table, station, ground, bounds, folder)
            fit = fit_channel(measured, station)
            posteriors.append(condition(fit.parameters, measured))
        except InputError as error:
            key = f"radio.survey[{number}]" + (f".{error.key}" if error.key else "")
            raise InputError(
                error.message, file=error.file, key=key, row=error.row, remedy=error.remedy
            ) from error
    return station_map(posteriors, table.threshold_dbm, bounds)


def _measured(
    survey: SurveyTable,
    radio: RadioTable,
    station: Station,
    ground: Ground,
    bounds: tuple[float, float, float, float],
    folder: Path,
) -> Measurements:
    """Return the measurements of a survey; simulated ones depend on its seed."""
    if survey.file is not None:
        return read_log(folder / survey.file, LogFormat(floor_dbm=survey.floor_dbm))
    if survey.places_m is not None and survey.power_dbm is not None:
        power, floor = np.array(survey.power_dbm), survey.floor_dbm
        censored = np.zeros(len(power), dtype=np.bool_) if floor is None else power <= floor
        return Measurements(np.array(survey.places_m), power, censored)
    assert survey.count is not None
    generator = np.random.default_rng(survey.seed)
    low, high = np.array(bounds[:2]), np.array(bounds[2:])
    cell_m = survey.decorrelation_m / CELLS
    if np.prod((high - low) / cell_m) > MOST_CELLS:
        raise InputError(
            f"gives more than {MOST_CELLS} cells", key="decorrelation_m", remedy="give a larger one"
        )
    parameters = ChannelParameters(
        radio.k_pl_db,
        radio.n_pl,
        survey.shadow_std_db,
        survey.decorrelation_m,
        survey.multipath_std_db,
        station,
    )
    truth = model_truth(parameters, bounds, cell_m, survey.floor_dbm, generator)
    places = low + (high - low) * generator.random((40 * survey.count, 2))
    free = places[ground.allows(places)][: survey.count]
    if len(free) < survey.count:
        raise InputError(
            f"only {len(free)} of {survey.count} positions are free",
            key="count",
            remedy="ask for fewer",
        )
    return measure(truth, free)
