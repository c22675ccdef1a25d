"""Small hand-made problems with a power that the tests choose: no file, no truth, no chance.

The channel is believed from readings on a 2 m grid of whatever the test says the power is; mean
and parameters are known, so that nothing is fitted. `GOOD` is far above the threshold, `BAD` far
below, so that the bound changes about half-way between two readings.
"""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from planopt import (
    BaseStation,
    ChannelSetup,
    Constraints,
    Measurements,
    Obstacle,
    PlannerSettings,
    Problem,
    Robot,
    Workspace,
)
from planopt.channel import (
    Belief,
    ChannelFit,
    ChannelParameters,
    ChannelPosterior,
    Station,
    Truth,
    condition,
)
from planopt.objectives import ReachObjective
from planopt.planning.initial_data import Prepared
from planopt.planning.plan import BEGINNING, History
from planopt.planning.proof.rule import (
    VerifierContext,
    obstacles_ahead,
    stations_law,
    verifier_context,
)
from planopt.planning.proof.verify import Judgement, verify
from planopt.planning.scene import Scene, build_scene
from planopt.planning.search.global_search import GlobalSearch
from planopt.planning.values.context import Aim, StepContext, step_context, workspace_region
from planopt.problems import LoggedMeasurements
from planopt.robots.dynamics import Drive
from planopt.world import (
    ObstacleIndex,
    Raster,
    RoadMap,
    build_lattice,
    build_road_map,
    index_obstacles,
)

PowerAt = Callable[[np.ndarray], np.ndarray]

GOOD, BAD = -60.0, -100.0
THRESHOLD_DBM = -80.0
SPACING_M = 2.0

# A thin wall, a U that opens to the left, and a ring: a block with a courtyard.
WALL = shapely.box(19.9, 5.0, 20.1, 25.0)
CUP = shapely.Polygon(
    [(14, 8), (26, 8), (26, 22), (14, 22), (14, 20), (24, 20), (24, 10), (14, 10)]
)
RING = shapely.Polygon(
    [(10, 5), (30, 5), (30, 25), (10, 25)], [[(14, 9), (26, 9), (26, 21), (14, 21)]]
)


def workspace_of(
    bounds_m: tuple[float, float, float, float], polygons: tuple[shapely.Polygon, ...]
) -> Workspace:
    obstacles = tuple(Obstacle(f"obstacle {k}", polygon) for k, polygon in enumerate(polygons))
    return Workspace(bounds_m, obstacles)


def small_road_map(
    *polygons: shapely.Polygon,
    bounds_m: tuple[float, float, float, float] = (0.0, 0.0, 10.0, 8.0),
    anchor_m: tuple[float, float] = (1.0, 1.0),
    spacing_m: float = 1.0,
    clearance_m: float = 0.1,
) -> RoadMap:
    """The road map of a rectangle with the given obstacles, anchored at a place."""
    step_m = spacing_m * float(np.sqrt(5.0))
    workspace = workspace_of(bounds_m, polygons)
    return build_road_map(build_lattice(workspace, np.array(anchor_m), step_m, clearance_m))


def small_problem(
    *polygons: shapely.Polygon,
    bounds_m: tuple[float, float, float, float] = (0.0, 0.0, 40.0, 30.0),
    start_m: tuple[float, float] = (5.0, 15.0),
    goal_m: tuple[float, float] = (35.0, 15.0),
    speed_max_m_s: float = 2.0,
    clearance_m: float = 0.5,
    goal_radius_m: float = 1.0,
    p_min: float = 0.9,
    threshold_dbm: float = THRESHOLD_DBM,
    cost_to_go: str = "connected",
    effort_weight_s2_m2: float = 0.1,
    horizon: int = 4,
    step_s: float = 1.0,
    planner: str = "auto",
    max_steps: int = 80,
) -> Problem:
    """A robot in a rectangle with the given obstacles; steps of 2 m."""
    return Problem(
        name="small",
        description="",
        workspace=workspace_of(bounds_m, polygons),
        channel=ChannelSetup(
            measurements=LoggedMeasurements(Path("none.csv")), measure_spacing_m=1.0
        ),
        robots=(Robot(start_m=start_m, goal_m=goal_m, speed_max_m_s=speed_max_m_s),),
        stations=(
            BaseStation(
                position_m=(0.0, 15.0),
                height_m=5.0,
                transmit_power_dbm=0.0,
                threshold_dbm=threshold_dbm,
            ),
        ),
        objective=ReachObjective(effort_weight_s2_m2, cost_to_go),
        constraints=Constraints(p_min=p_min, clearance_m=clearance_m, goal_radius_m=goal_radius_m),
        planner=PlannerSettings(
            name=planner, horizon=horizon, step_s=step_s, neighbours=32, max_steps=max_steps
        ),
    )


def good_everywhere(positions_m: np.ndarray) -> np.ndarray:
    return np.full(len(positions_m), GOOD)


def bad_everywhere(positions_m: np.ndarray) -> np.ndarray:
    return np.full(len(positions_m), BAD)


def bad_where(is_bad: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> PowerAt:
    def power(positions_m: np.ndarray) -> np.ndarray:
        return np.where(is_bad(positions_m[:, 0], positions_m[:, 1]), BAD, GOOD)

    return power


def bad_disc(x_m: float, y_m: float, radius_m: float) -> PowerAt:
    return bad_where(lambda x, y: np.hypot(x - x_m, y - y_m) < radius_m)


def bad_band(low_m: float, high_m: float, open_above_m: float = np.inf) -> PowerAt:
    """Connected but in an upright band, which ends at a height if one is given."""
    return bad_where(lambda x, y: (x > low_m) & (x < high_m) & (y < open_above_m))


def grid_m(bounds_m: tuple[float, float, float, float], spacing_m: float) -> np.ndarray:
    """Places on a grid over the workspace, symmetric about its middle."""
    x_min, y_min, x_max, y_max = bounds_m
    x = np.arange(x_min + spacing_m / 2, x_max, spacing_m)
    y = np.arange(y_min + spacing_m / 2, y_max, spacing_m)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def belief_of(problem: Problem, power_at: PowerAt = good_everywhere, scale: float = 1.0) -> Belief:
    """What readings of `power_at` on a grid tell; `scale` stretches grid and decorrelation."""
    return _belief(problem.workspace.bounds_m, problem.stations[0].site, power_at, scale)


@lru_cache(maxsize=64)
def _belief(
    bounds_m: tuple[float, float, float, float], site: Station, power_at: PowerAt, scale: float
) -> Belief:
    places = grid_m(bounds_m, SPACING_M * scale)
    measurements = Measurements(places, power_at(places), np.zeros(len(places), dtype=bool))
    parameters = ChannelParameters(
        k_pl_db=THRESHOLD_DBM,
        n_pl=0.0,
        shadow_std_db=8.0,
        decorrelation_m=20.0 * scale,
        multipath_std_db=0.3,
        station=site,
    )
    names = ("k_pl_db", "n_pl", "shadow_std_db", "decorrelation_m", "multipath_std_db")
    fit = ChannelFit(
        "reml", "ok", parameters, dict.fromkeys(names, 0.1), np.eye(2), len(places), 0, (), 0.0
    )
    return Belief(fit, condition(parameters, measurements, theta="known"))


def prepared_of(problem: Problem, power_at: PowerAt = good_everywhere) -> Prepared:
    """The belief of :func:`belief_of` and a truth that is just that power, by 1 m cells."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    x, y = np.arange(x_min + 0.5, x_max), np.arange(y_min + 0.5, y_max)
    cells = np.stack(np.meshgrid(x, y), axis=-1)
    values = power_at(cells.reshape(-1, 2)).reshape(cells.shape[:2])
    return Prepared((Truth(Raster(x, y, values), None, values),), belief_of(problem, power_at))


def straight_path(problem: Problem, step_m: float = 1.9) -> np.ndarray:
    """``(N + 1, 2)`` from the start straight towards the goal in equal steps."""
    robot = problem.robots[0]
    start, goal = np.asarray(robot.start_m), np.asarray(robot.goal_m)
    heading = (goal - start) / np.linalg.norm(goal - start)
    return start + step_m * np.arange(problem.planner.horizon + 1)[:, None] * heading


def kriged(belief: Belief, positions_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviation at places (n, 2) by equation 1.6 written out: theta known, n_PL 0.

    A measured place has its reading, without deviation.
    """
    parameters, measured = belief.posterior.parameters, belief.posterior.measurements

    def covariance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        distance = np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1])
        return parameters.shadow_std_db**2 * np.exp(-distance / parameters.decorrelation_m)

    noise = parameters.multipath_std_db**2
    known = covariance(measured.positions_m, measured.positions_m) + noise * np.eye(len(measured))
    across = covariance(measured.positions_m, positions_m)
    weights = np.linalg.solve(known, across)
    mean = parameters.k_pl_db + weights.T @ (measured.power_dbm - parameters.k_pl_db)
    variance = parameters.shadow_std_db**2 + noise - (across * weights).sum(0)
    same = (measured.positions_m[:, None] == positions_m).all(axis=2)
    read = np.where(same, measured.power_dbm[:, None], -np.inf).max(axis=0, initial=-np.inf)
    return np.where(same.any(axis=0), read, mean), np.where(
        same.any(axis=0), 0.0, np.sqrt(variance)
    )


def search_of(
    problem: Problem, power_at: PowerAt = good_everywhere
) -> tuple[GlobalSearch, Belief, Scene]:
    """A new search, the belief that its margins follow, and the scene."""
    scene, belief = build_scene(problem), belief_of(problem, power_at)
    search = GlobalSearch(problem, scene)
    search.margins.refresh(stations_law(problem, belief.posteriors))
    return search, belief, scene


def context_of(
    problem: Problem, belief: Belief, position_m: np.ndarray, history: History = BEGINNING
) -> StepContext:
    """What a search is told of a step."""
    index = index_obstacles(problem.workspace)
    base = verifier_context(problem, index, belief.posteriors, np.asarray(position_m), history)
    return step_context(base, workspace_region(problem), Aim())


def verified(
    problem: Problem,
    index: ObstacleIndex,
    posterior: ChannelPosterior,
    start: np.ndarray,
    path_m: np.ndarray,
    kkt_residual: float | None = None,
    drive: Drive | None = None,
    **known: Any,
) -> Judgement:
    """The verifier's judgement of a path, by default beside the problem's moving obstacles."""
    known = {"posteriors": (posterior,), "moving": obstacles_ahead(problem, 0)} | known
    context = VerifierContext(problem, index, state=np.asarray(start), **known)
    return verify(context, path_m, kkt_residual, drive)
