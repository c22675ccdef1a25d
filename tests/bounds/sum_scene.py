"""Random scenes whose objective is a sum over the steps, with their step context."""

from dataclasses import replace

import numpy as np
import shapely

import planopt
from planopt.bounds.bound import Design
from planopt.bounds.stages import stage_problem, summed_terms
from planopt.bounds.tube import StageProblem
from planopt.channel import ChannelParameters, Measurements, condition
from planopt.objectives import LearningTerm, MappingTerm, MotionEnergyTerm, TrackingTerm
from planopt.planning.proof.rule import verifier_context
from planopt.planning.values.context import Aim, StepContext, step_context, workspace_region
from planopt.planning.values.objective_value import ObjectiveValue
from planopt.world.clearance import index_obstacles, segment_clearance_m
from planopt.world.motion import MovingDiscs, paths_gap_m

SIZE_M = 40.0
STEP_M = 2.0
APART_M = 2.0


def sum_context(
    seed: int, steps: int, *, energy: bool = True, plain: bool = False, measured: str = ""
) -> StepContext:
    """A random channel, target and sensor, up to three obstacles, one or two stations.

    `measured` replaces tracking by mapping (``map``) or by a criterion of learning.
    """
    generator = np.random.default_rng(seed)
    uniform = generator.uniform
    start = uniform(10.0, 30.0, 2)
    sites = uniform(5.0, 35.0, (1 if plain else int(generator.integers(1, 3)), 2))
    stations = [
        planopt.BaseStation(
            name=f"s{number}",
            position_m=tuple(site),
            transmit_power_dbm=0.0,
            threshold_dbm=float(uniform(-45, -38)),
        )
        for number, site in enumerate(sites)
    ]
    sensor = {
        "noise_curvature": float(uniform(0.005, 0.05)),
        "noise_floor_m2": float(uniform(0.05, 0.5)),
        "sweet_spot_m": float(generator.choice([0.0, 1.0, 4.0])),
    }
    terms: list[planopt.objectives.Term] = [
        TrackingTerm(**sensor, form="additive", terminal_weight=float(uniform(0.5, 2.0)))
    ]
    if measured == "map":
        terms = [MappingTerm(weight=float(uniform(0.5, 2.0)))]
    elif measured:
        terms = [LearningTerm(criterion=measured, weight=float(uniform(0.5, 2.0)))]
    if energy:
        power = float(generator.choice([0.0, 0.3]))
        terms.append(MotionEnergyTerm(float(uniform(0.0, 1.0)), power, weight=float(uniform())))
    corners = uniform(4.0, 32.0, (0 if plain else int(generator.integers(0, 4)), 2))
    boxes = [shapely.box(x, y, x + 4.0, y + 3.0) for x, y in corners]
    boxes = [box for box in boxes if box.distance(shapely.Point(start)) > 1.0]
    problem = planopt.Problem(
        robots=planopt.Robot(start_m=tuple(start), speed_max_m_s=STEP_M),
        stations=stations,
        workspace=planopt.Workspace(
            (0.0, 0.0, SIZE_M, SIZE_M),
            [planopt.Obstacle(f"box {k}", b) for k, b in enumerate(boxes)],
        ),
        objective=terms,
        targets=() if measured else planopt.Target(start_m=(20.0, 20.0), velocity_m_s=(0.0, 0.0)),
        constraints=planopt.Constraints(clearance_m=float(generator.choice([0.0, 0.5]))),
        planner=planopt.PlannerSettings(step_s=1.0, horizon=steps),
    )
    posteriors = []
    for station in stations:
        parameters = ChannelParameters(
            -10.0,
            float(uniform(1.8, 3.0)),
            float(uniform(1.0, 6.0)),
            float(uniform(1.0, 20.0)),
            float(uniform(0.3, 3.0)),
            station.site,
        )
        places = uniform(0.0, SIZE_M, (int(generator.integers(5, 40)), 2))
        power = -10.0 - 20.0 * np.log10(np.hypot(*(places - station.position_m).T) + 1.0)
        posteriors.append(
            condition(
                parameters, Measurements(places, power + generator.normal(0.0, 4.0, len(power)))
            )
        )
    angle = uniform(0.0, 2.0 * np.pi)
    line = start + uniform(-6.0, 6.0, 2)
    target = line + np.arange(1, steps + 1)[:, None] * [np.cos(angle), np.sin(angle)]
    base = verifier_context(problem, index_obstacles(problem.workspace), posteriors, start)
    return step_context(base, workspace_region(problem), Aim(None if measured else target))


def with_others(context: StepContext, count: int, seed: int) -> StepContext:
    """The context with other robots that walk near the first one, 2 m to keep apart."""
    steps, generator = context.problem.planner.horizon, np.random.default_rng(seed)
    starts = context.position_m + generator.uniform(1.5, 4.0, (count, 1, 2)) * generator.choice(
        [-1.0, 1.0], (count, 1, 2)
    )
    walks = starts + np.cumsum(generator.normal(0.0, 1.0, (count, steps + 1, 2)), axis=1)
    discs = MovingDiscs(
        tuple(f"other {k}" for k in range(count)),
        walks,
        np.zeros((count, steps)),
        np.full(count, APART_M),
        np.ones(count, dtype=np.bool_),
    )
    return replace(context, moving=discs)


def stages_in(
    context: StepContext, p_min: float = 0.0, design: Design | None = None
) -> StageProblem:
    """The stage problem of a context, with p_min at all its steps, for a design."""
    problem = context.problem
    problem = replace(problem, constraints=replace(problem.constraints, p_min=p_min))
    kept = np.full(problem.planner.horizon, p_min > 0.0)
    terms = summed_terms(problem, context)
    return stage_problem(problem, context, terms, kept, design or Design(), context.moving)


def random_paths(context: StepContext, count: int, seed: int) -> np.ndarray:
    """Random feasible paths (n, N, 2): walks of all step lengths, some to positions of readings."""
    generator = np.random.default_rng(seed)
    steps = context.problem.planner.horizon
    walls = shapely.union_all(
        [each.polygon for each in context.problem.workspace.obstacles] or [shapely.Polygon()]
    ).buffer(context.problem.constraints.clearance_m)
    known = np.vstack([station.measurements.positions_m for station in context.posteriors])
    paths = np.empty((count, steps, 2))
    here = np.broadcast_to(context.position_m, (count, 2)).copy()
    heading = generator.uniform(0.0, 2.0 * np.pi, count)
    for k in range(steps):
        heading += generator.normal(0.0, 0.5, count)
        length = STEP_M * generator.uniform(size=count) ** generator.choice([0.0, 0.3, 2.0], count)
        there = here + length[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        away = np.linalg.norm(here[:, None] - known, axis=2)
        visit = (away.min(axis=1) <= STEP_M) & (generator.uniform(size=count) < 0.3)
        there[visit] = known[away.argmin(axis=1)][visit]
        free = ((there >= 0.0) & (there <= SIZE_M)).all(axis=1)
        free &= ~shapely.contains_xy(walls, *there.T) if not walls.is_empty else True
        here = np.where(free[:, None], there, here)
        paths[:, k] = here
    return paths


def clear_of_all(context: StepContext, paths: np.ndarray) -> np.ndarray:
    """The paths (n, N, 2) whose steps keep away from other robots and from obstacles."""
    starts = np.broadcast_to(context.position_m, (len(paths), 1, 2))
    whole, limit = np.concatenate([starts, paths], axis=1), context.problem.constraints.clearance_m
    clear = paths_gap_m(context.moving, whole) >= 0.0
    ends = whole[:, :-1].reshape(-1, 2), whole[:, 1:].reshape(-1, 2)
    away = segment_clearance_m(context.index, *ends).reshape(len(paths), -1).min(axis=1)
    return paths[clear & (away >= limit)]


def values_of(context: StepContext, paths: np.ndarray) -> np.ndarray:
    """The objective's values of paths (n, N, 2), as results report them."""
    return np.array(ObjectiveValue(context).of_each(list(paths)))
