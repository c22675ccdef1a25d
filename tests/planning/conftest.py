"""Small hand-made problems for the tests of planning: no file, no truth, no random map."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapely

from planopt.channel.parameters import Station
from planopt.planning.road_map import RoadMap, build_road_map
from planopt.problems.problem import (
    ChannelSetup,
    Constraints,
    LoggedMeasurements,
    PlannerSettings,
    Problem,
    RadioStation,
    ReachObjective,
    Robot,
)
from planopt.world.lattice import build_lattice
from planopt.world.workspace import Obstacle, Workspace

MakeProblem = Callable[..., Problem]
MakeRoadMap = Callable[..., RoadMap]


def _workspace(
    bounds_m: tuple[float, float, float, float], polygons: tuple[shapely.Polygon, ...]
) -> Workspace:
    obstacles = tuple(Obstacle(f"obstacle {k}", polygon) for k, polygon in enumerate(polygons))
    return Workspace(bounds_m, obstacles)


@pytest.fixture
def make_problem() -> MakeProblem:
    """Build a problem on a rectangle with the given polygons as obstacles."""

    def make(
        *polygons: shapely.Polygon,
        bounds_m: tuple[float, float, float, float] = (0.0, 0.0, 40.0, 30.0),
        start_m: tuple[float, float] = (5.0, 15.0),
        goal_m: tuple[float, float] = (35.0, 15.0),
        speed_max_m_s: float = 2.0,
        clearance_m: float = 0.5,
        p_min: float = 0.9,
        threshold_dbm: float = -90.0,
        cost_to_go: str = "geodesic",
        effort_weight_s2_m2: float = 0.1,
        horizon: int = 4,
        planner: str = "auto",
        neighbours: int = 32,
    ) -> Problem:
        return Problem(
            name="small",
            description="",
            workspace=_workspace(bounds_m, polygons),
            channel=ChannelSetup(
                None,
                LoggedMeasurements(Path("none.csv"), ("x_m", "y_m", "power_dbm"), None, None),
                "reml",
                1.0,
            ),
            robots=(Robot("robot", start_m, goal_m, speed_max_m_s),),
            stations=(RadioStation("station", Station((0.0, 15.0), 5.0), 0.0, threshold_dbm),),
            objective=ReachObjective(effort_weight_s2_m2, cost_to_go),
            constraints=Constraints(p_min, clearance_m, 1.0),
            planner=PlannerSettings(planner, horizon, 1.0, neighbours, 50),
        )

    return make


@pytest.fixture
def make_road_map() -> MakeRoadMap:
    """Build the road map of a rectangle with polygons, anchored at a place."""

    def make(
        *polygons: shapely.Polygon,
        bounds_m: tuple[float, float, float, float] = (0.0, 0.0, 10.0, 8.0),
        anchor_m: tuple[float, float] = (1.0, 1.0),
        spacing_m: float = 1.0,
        clearance_m: float = 0.1,
    ) -> RoadMap:
        workspace = _workspace(bounds_m, polygons)
        step_m = spacing_m * float(np.sqrt(5.0))
        return build_road_map(build_lattice(workspace, np.array(anchor_m), step_m, clearance_m))

    return make
