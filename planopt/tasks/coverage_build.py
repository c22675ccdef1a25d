"""Validated problems of the task coverage, and the scenes built from them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy.spatial import KDTree

from planopt.arrays import Floats, Mask
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
from planopt.coverage.assignment import LEAST_ON_RING, Demand
from planopt.coverage.control.movers import LawMover, Mover, RecedingMover
from planopt.coverage.control.radio import radio_tree
from planopt.coverage.density import Density, RasterDensity, checked_mass
from planopt.coverage.events import Event, Sensing
from planopt.coverage.geodesic import Ground, geodesic_ground
from planopt.coverage.ground import ConvexGround
from planopt.coverage.limits import LinkLaw, RadioLimits, StationMap, station_map
from planopt.coverage.localisation import EventSensor
from planopt.coverage.simulation import Scene
from planopt.coverage.voronoi import checked_polygon, convex_region
from planopt.errors import InputError
from planopt.problems.tasks import TaskProblem
from planopt.tasks.coverage_tables import (
    AgentsTable,
    CoverageFile,
    GridTable,
    PlacesTable,
    RadioTable,
    SurveyTable,
    WorldTable,
    demand_of,
    density_of,
)
from planopt.world.raster import Raster

NODES = 1600  # Approximate number of nodes of a geodesic ground without an explicit spacing
SETTLED_SHARE = 0.01  # Default settling distance as a share of the mean distance between agents
CELLS = 8  # Number of cells of a simulated channel per decorrelation distance
MOST_CELLS = 1_000_000  # Maximum number of cells of a simulated channel
DRAWN = 400  # Number of candidates drawn for random starts, in addition to four per agent
START_SPARE = 0.1  # Minimum gap between bodies at random starts, as a share of their radius
MEMORY_STEPS = 10  # Default memory of readings, in steps, if events move


@dataclass(frozen=True, eq=False, repr=False)
class CoverageProblem(TaskProblem):
    """Problem of the task coverage."""

    config: CoverageFile
    scene: Scene
    density: Density
    station_map: StationMap | None = None  # Estimated links to stations; None for the path loss law

    def starts(self, generator: np.random.Generator) -> Floats:
        """Return validated starting positions (n, 2): free, separated and linked to a station."""
        table, ground, joins = self.config.agents, self.scene.ground, self.scene.joins_s
        body_m, starts = table.body_radius_m, starts_of(table, ground, generator)
        listed = isinstance(table.start, PlacesTable)

        def key(agent: int) -> str:
            """Return the name of the key that sets an agent's starting position."""
            return f"agents.start.places_m[{agent}]" if listed else "agents.start"

        outside = np.flatnonzero(~has_room(ground, starts, body_m))
        if len(outside):
            x, y = starts[outside[0]]
            raise InputError(
                f"agent {outside[0]} starts at ({x:g}, {y:g}) m, which is outside the region, "
                "in an obstacle or too close to one",
                key=key(int(outside[0])),
            )
        for joins_s in np.unique(joins):
            who = np.flatnonzero(joins == joins_s)
            touching = overlapping(starts[who], body_m)
            if touching is not None:
                one, other = who[list(touching)].tolist()
                apart_m = float(np.linalg.norm(starts[one] - starts[other]))
                raise InputError(
                    f"agents {one} and {other} overlap: they start {apart_m:g} m apart, less "
                    f"than the body diameter of {2.0 * body_m:g} m",
                    key=key(other),
                    remedy="place them farther apart, or give a smaller agents.body_radius_m",
                )
        if self.radio is not None:
            lonely = np.flatnonzero(~radio_tree(starts[joins == 0.0], self.radio).connected)
            if len(lonely):
                raise InputError(
                    f"{len(lonely)} of {len(starts)} agents start without a link to a station",
                    key="agents.start",
                    remedy="let them start closer to a station, or reduce radio.p_min",
                )
        return starts

    @property
    def radio(self) -> RadioLimits | None:
        """Return the radio requirement; None if there is none."""
        table = self.config.radio
        if table is None:
            return None
        spread = np.diag([table.k_pl_std_db**2, table.n_pl_std**2])
        law = LinkLaw(np.array([table.k_pl_db, table.n_pl]), table.deviation_db, spread)
        stations, to_stations = np.array(table.stations_m), self.station_map or law
        return RadioLimits(stations, to_stations, law, table.threshold_dbm, table.p_min)

    @property
    def mover(self) -> Mover:
        """Return the control law or planner that moves the agents."""
        planner = self.config.planner
        control, limits = self.config.control, self.config.limits
        if planner.name != "law":
            deploys = planner.name == "deploy"
            return RecedingMover(
                control.gains, limits, planner.horizon, self.radio, planner.lead_events, deploys
            )
        bodies = limits.body_radius_m > 0.0
        inert = limits.acceleration_m_s2 is not None or limits.turn_rate_rad_s is not None
        if inert or bodies:
            raise InputError(
                'is "law", which cannot enforce '
                + ("limits of acceleration or turn rate" if inert else "distances between bodies"),
                key="planner.name",
                remedy="use receding or deploy",
            )
        return LawMover(control.gains, control.time_step_s, self.config.agents.speed_max_m_s)

    def tables(self) -> dict[str, Any]:
        """Return the complete tables, with defaults and rasters inline."""
        found = super().tables()
        if isinstance(self.density, RasterDensity):
            raster: Raster = self.density.raster
            found["density"] = {
                "kind": "raster",
                "x_m": raster.x_m.tolist(),
                "y_m": raster.y_m.tolist(),
                "values": raster.values.tolist(),
            }
        posteriors = () if self.station_map is None else self.station_map.posteriors
        for number, posterior in enumerate(posteriors):
            survey = found["radio"]["survey"][number]
            if survey.pop("file", None) is not None:
                measured = posterior.measurements
                survey["places_m"] = measured.positions_m.tolist()
                survey["power_dbm"] = measured.power_dbm.tolist()
        return found

    def words(self) -> Sequence[str]:
        """Return a text summary of the problem, line by line."""
        config, limit = self.config, self.config.agents.speed_max_m_s
        speed = "without a speed limit" if limit is None else f"at most {limit:g} m/s"
        counted = "agents know their number"
        if config.counting.method != "known":
            counted = f"agents count themselves by {config.counting.method}"
        lines = [
            f"{self.name}: {self.description}",
            f"  task        coverage, planner {config.planner.name}, steps of "
            f"{config.control.time_step_s:g} s, at most {config.control.duration_s:g} s",
            f"  region      {self.scene.ground.area_m2:g} m^2, {len(self.obstacles)} obstacles, "
            f"density {config.density.kind}",
            f"  agents      {config.agents.start.number}, {speed}; {counted}",
        ]
        for event in self.scene.events:
            x, y = event.place_m
            end = "" if np.isinf(event.ends_s) else f" to {event.ends_s:g} s"
            lines.append(
                f"  event       {event.name} at ({x:g}, {y:g}) m from {event.appears_s:g} s{end}"
            )
        return lines


def build(config: CoverageFile, folder: Path, file: Path | None) -> CoverageProblem:
    """Build the problem from validated tables."""
    density, control, sensing = density_of(config.density, folder), config.control, _sensing(config)
    ground = _ground(config.world, density, config.agents.body_radius_m)
    agents = config.agents.start.number
    joins, leaves = _times(config, agents)
    config.control.gains.shares(np.array([True]), control.time_step_s)
    if control.duration_s < control.time_step_s:
        raise InputError("is shorter than one step, control.time_step_s", key="control.duration_s")
    events: list[Event] = []
    demands: list[Demand] = []
    for number, table in enumerate(config.events):
        key, event = f"events[{number}]", _event(config, number, ground)
        if event.name in [each.name for each in events]:
            raise InputError(f"is {event.name!r}, the name of another event", key=f"{key}.name")
        if sensing is None:
            raise InputError(
                "is missing, but the problem has events",
                key="sensor",
                remedy="add the table [sensor]",
            )
        events.append(event)
        demands.append(demand_of(table.demand, f"{key}.demand", sensing, ground.area_m2, agents))
    _require_agents(events, joins, leaves)
    if config.assignment.stand_off and agents < LEAST_ON_RING:
        raise InputError(
            f"needs at least {LEAST_ON_RING} agents to locate an event, but there are {agents}",
            key="assignment.stand_off",
            remedy="add agents, or set stand_off = false",
        )
    mapped = None if config.radio is None else station_map_of(config.radio, ground, folder)
    scene = _scene(config, ground, tuple(events), tuple(demands), sensing, joins, leaves)
    problem = CoverageProblem(config, file, scene, density, mapped)
    problem.starts(np.random.default_rng(0))
    assert problem.mover  # Raises for limits that the planner does not support
    return problem


def _scene(
    config: CoverageFile,
    ground: Ground,
    events: tuple[Event, ...],
    demands: tuple[Demand, ...],
    sensing: Sensing | None,
    joins_s: Floats,
    leaves_s: Floats,
) -> Scene:
    """Return the scene for the network simulator."""
    control, rules, body_m = config.control, config.assignment, config.agents.body_radius_m
    settled_m = control.settled_m
    if settled_m is None:
        settled_m = SETTLED_SHARE * math.sqrt(ground.area_m2 / len(joins_s))
    stand_off_m = None
    if sensing is not None and rules.stand_off:
        stand_off_m = sensing.sensor.best_distance_m
    limits = config.limits
    most = limits.acceleration_m_s2
    return Scene(
        ground, joins_s, leaves_s, events, demands, sensing, stand_off_m, control.partition,
        control.gains, rules.hysteresis_m, config.counting, config.links, rules.flag_rounds,
        control.time_step_s, control.duration_s, settled_m, control.stop_when_settled,
        2.0 * body_m + limits.longest_stop_m if body_m > 0.0 else None, body_m,
        0.0 if most is None else limits.speed_m_s / most,
    )  # fmt: skip


def overlapping(places_m: Floats, body_radius_m: float) -> tuple[int, int] | None:
    """Return the first pair of bodies at positions ``(n, 2)`` that touch; None without contact."""
    if body_radius_m == 0.0:
        return None
    return min(KDTree(places_m).query_pairs(2.0 * body_radius_m), default=None)


def _ground(world: WorldTable, density: Density, body_radius_m: float) -> Ground:
    """Return a convex ground if the world is convex without obstacles, else a geodesic one."""
    if world.bounds_m is not None:
        x0, y0, x1, y1 = world.bounds_m
        if not (x0 < x1 and y0 < y1):
            raise InputError(
                "should have x_min < x_max and y_min < y_max",
                key="world.bounds_m",
                remedy="give [x_min, y_min, x_max, y_max] in metres",
            )
        outline = shapely.box(x0, y0, x1, y1)
    else:
        outline = checked_polygon(np.array(world.outline_m))
    missing_m2 = outline.convex_hull.area - outline.area
    if not world.obstacles and world.clearance_m == 0.0 and missing_m2 <= 1e-9 * outline.area:
        region = convex_region(outline)
        if isinstance(density, RasterDensity) and not density.covers(region):
            raise InputError("does not cover the region", key="density")
        checked_mass(region, density)
        return ConvexGround(region, density, world.sensing_range_m)
    if world.sensing_range_m is not None:
        raise InputError(
            "applies only to a convex region without obstacles",
            key="world.sensing_range_m",
            remedy="leave it out: geodesic cells have no sensing range",
        )
    spacing_m = world.spacing_m or math.sqrt(outline.area / NODES)
    shapes = [each.polygon for each in world.obstacles]
    keep_m = max(world.clearance_m, body_radius_m)
    return geodesic_ground(outline, shapes, spacing_m, density, keep_m)


def _times(config: CoverageFile, agents: int) -> tuple[Floats, Floats]:
    """Return the times at which agents join and leave, (n,) each."""
    joins, leaves = np.zeros(agents), np.full(agents, np.inf)
    for number, table in enumerate(config.changes):
        for agent in table.agents:
            if not 0 <= agent < agents:
                raise InputError(
                    f"has agent {agent}, but the {agents} agents are numbered from 0 to "
                    f"{agents - 1}",
                    key=f"changes[{number}].agents",
                )
            joins[agent] = table.joins_s
            leaves[agent] = math.inf if table.leaves_s is None else table.leaves_s
        if table.leaves_s is not None and table.leaves_s <= table.joins_s:
            raise InputError(
                "should be later than joins_s",
                key=f"changes[{number}].leaves_s",
                remedy="give a later time",
            )
    for time_s in np.concatenate(([0.0], leaves[np.isfinite(leaves)])).tolist():
        if time_s < config.control.duration_s and not ((joins <= time_s) & (time_s < leaves)).any():
            raise InputError(f"leave no active agent at {time_s:g} s", key="changes")
    return joins, leaves


def _sensing(config: CoverageFile) -> Sensing | None:
    """Return the event sensor with its detection rules; None without a sensor."""
    table = config.sensor
    if table is None:
        return None
    sensor = EventSensor(table.noise_std, table.strength, table.scale_m)
    memory_s, moving = table.memory_s, any(any(each.velocity_m_s) for each in config.events)
    if memory_s is None and moving:
        memory_s = MEMORY_STEPS * config.control.time_step_s
    return Sensing(
        sensor,
        table.strength_known,
        table.detection_std,
        table.silent_steps,
        memory_s,
        table.event_speed_std_m_s if moving else None,
    )


def _event(config: CoverageFile, number: int, ground: Ground) -> Event:
    """Return an event; raise `InputError` if its path leaves the allowed area."""
    table, key = config.events[number], f"events[{number}]"
    ends_s = math.inf if table.ends_s is None else table.ends_s
    if ends_s <= table.appears_s:
        raise InputError(
            "should be later than appears_s", key=f"{key}.ends_s", remedy="give a later time"
        )
    event = Event(table.name, table.place_m, table.appears_s, ends_s, table.velocity_m_s)
    last_s = min(ends_s, max(config.control.duration_s, table.appears_s))
    path = np.linspace(event.place_at(table.appears_s), event.place_at(last_s), 65)
    out = np.flatnonzero(~ground.allows(path))
    if len(out):
        x, y = path[out[0]]
        raise InputError(
            f"{table.name} passes ({x:g}, {y:g}) m, where no agent can be: outside the region, in "
            "an obstacle or too close to one",
            key=f"{key}.place_m" if out[0] == 0 else f"{key}.velocity_m_s",
            remedy="move the event, or change its velocity",
        )
    return event


def _require_agents(events: Sequence[Event], joins: Floats, leaves: Floats) -> None:
    """Raise `InputError` if an event appears when there are fewer agents than events."""
    for number, event in enumerate(events):
        there = sum(each.is_there(event.appears_s) for each in events)
        agents = int(((joins <= event.appears_s) & (event.appears_s < leaves)).sum())
        if agents < there:
            raise InputError(
                f"is {event.appears_s:g} s, when the number of events ({there}) exceeds that "
                f"of active agents ({agents})",
                key=f"events[{number}].appears_s",
                remedy="add agents, or reduce the number of simultaneous events",
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
            f"free start positions were found for only {len(found)} of {start.count} agents",
            key="agents.start.within_m",
            remedy="enlarge the area"
            + (", or reduce agents.body_radius_m" if body_m > 0.0 else ""),
        )
    return found[: start.count]


def has_room(ground: Ground, places_m: Floats, body_radius_m: float) -> Mask:
    """Return a mask (k,) of positions (k, 2) at which a body fits into the ground."""
    inside = ground.allows(places_m)
    if body_radius_m == 0.0:
        return inside
    return inside & (ground.hull.excess_m(places_m) <= 1e-9 - body_radius_m)


def _spread(places_m: Floats, apart_m: float, most: int) -> list[int]:
    """Return indices of at most `most` positions, chosen greedily at least `apart_m` apart."""
    chosen: list[int] = []
    for number, place in enumerate(places_m):
        if len(chosen) == most:
            break
        if (((places_m[chosen] - place) ** 2).sum(axis=1) >= apart_m**2).all():
            chosen.append(number)
    return chosen


def station_map_of(table: RadioTable, ground: Ground, folder: Path) -> StationMap | None:
    """Return the map of link failures estimated from radio surveys; None without surveys."""
    if not table.survey:
        return None
    if len(table.survey) != len(table.stations_m):
        raise InputError(
            f"has {len(table.survey)} entries, but the number of stations is "
            f"{len(table.stations_m)}",
            key="radio.survey",
            remedy="give one entry for each station, in the same order",
        )
    low, high = ground.hull.corners_m.min(axis=0), ground.hull.corners_m.max(axis=0)
    bounds = float(low[0]), float(low[1]), float(high[0]), float(high[1])
    posteriors: list[ChannelPosterior] = []
    for number, (survey, place) in enumerate(zip(table.survey, table.stations_m, strict=True)):
        station = Station(place)
        try:
            measured = _measured(survey, table, station, ground, bounds, folder)
            fit = fit_channel(measured, station, "reml")
            posteriors.append(condition(fit.parameters, measured))
        except InputError as error:
            raise error.under(f"radio.survey[{number}]") from error
    return station_map(posteriors, table.threshold_dbm, bounds)


def _measured(
    survey: SurveyTable,
    radio: RadioTable,
    station: Station,
    ground: Ground,
    bounds: tuple[float, float, float, float],
    folder: Path,
) -> Measurements:
    """Return the measurements of a survey: its log, its inline table, or simulated ones."""
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
            f"makes a map of more than {MOST_CELLS} cells",
            key="decorrelation_m",
            remedy="increase it",
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
            f"is {survey.count}, but only {len(free)} free positions were found",
            key="count",
            remedy="reduce the count",
        )
    return measure(truth, free)
