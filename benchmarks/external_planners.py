"""Who wins where: planopt against planners from outside, on fresh random maps.

``python benchmarks/external_planners.py goals --first-seed 9000 --seeds 12`` drives couriers: A*,
the colour rule and RRT* (``examples/planners``) drive their own paths, without planopt's verifier
and fallbacks. All start with the same measurements, measure after each step and plan again. The
cost of a run (its length plus the outage price times its length truly out of contact) is divided by
that of the clairvoyant.

``... tasks --problems A B --planners auto do_mpc --metric M`` compares planners that are registered
by name on problems of other tasks, in closed loops through planopt.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import shapely
from scipy.stats import t as student

sys.path.append(str(Path(__file__).parents[1] / "examples" / "planners"))

from astar import AStarPlanner
from colour_rule import ColourRulePlanner
from rrt_star import RrtStarPlanner

from planopt import NoPlanError, Problem, simulate
from planopt.channel import measure
from planopt.extend import PlannerKind, register_planner
from planopt.planning.initial_data import Prepared, prepare
from planopt.planning.loop.metrics import clairvoyant_path, realised_cost_m
from planopt.planning.proof.motion import is_at_goal
from planopt.planning.proof.rule import verifier_context
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import Scene, build_scene
from planopt.planning.stepping import learn_measured
from planopt.planning.values.context import Aim, step_context, workspace_region
from planopt.problems.load import with_overrides
from planopt.problems.problem import problem_from_tables

OUTSIDE = {"astar": AStarPlanner, "colour_rule": ColourRulePlanner, "rrt_star": RrtStarPlanner}
WIDTH_M, HEIGHT_M, OBSTACLES = 120.0, 100.0, 7
LONGEST = 4.0
"""A run is given up after so many times the steps of the straight line."""


def random_map(seed: int) -> Problem:
    """Return a courier in a field with random buildings, station and threshold."""
    generator = np.random.default_rng(seed)
    bounds = [0.0, 0.0, WIDTH_M, HEIGHT_M]
    start = [8.0, float(generator.uniform(10.0, HEIGHT_M - 10.0))]
    goal = [WIDTH_M - 8.0, float(generator.uniform(10.0, HEIGHT_M - 10.0))]
    ends = shapely.union_all([shapely.Point(*place).buffer(4.0) for place in (start, goal)])
    obstacles: list[dict[str, Any]] = []
    while len(obstacles) < OBSTACLES:
        x, y = generator.uniform([12.0, 0.0], [WIDTH_M - 12.0, HEIGHT_M])
        w, h = generator.uniform(4.0, 34.0, 2)
        box = shapely.box(x - w / 2, max(y - h / 2, 0.0), x + w / 2, min(y + h / 2, HEIGHT_M))
        if not box.intersects(ends):
            ring = shapely.get_coordinates(box)[:-1].tolist()
            obstacles.append({"name": f"block {len(obstacles)}", "polygon": ring})
    station = {
        "name": "mast",
        "position_m": generator.uniform([20.0, 5.0], [WIDTH_M - 20.0, HEIGHT_M - 5.0]).tolist(),
        "height_m": 3.0,
        "transmit_power_dbm": 20.0,
        "threshold_dbm": float(generator.uniform(-58.0, -50.0)),
    }
    truth = {"kind": "model", "k_pl_db": -30.0, "n_pl": 2.6, "shadow_std_db": 5.0}
    truth |= {"decorrelation_m": 12.0, "multipath_std_db": 1.5, "cell_m": 1.0}
    tables = {
        "problem": {"schema": 1, "name": f"map_{seed}", "task": "reach"},
        "world": {"bounds_m": bounds, "obstacles": obstacles},
        "channel": {
            "truth": truth,
            "measurements": {"count": int(generator.choice([40, 120])), "spacing_m": 2.0},
            "fit": {"method": "reml"},
        },
        "robots": [{"name": "rover", "start_m": start, "goal_m": goal, "speed_max_m_s": 2.0}],
        "stations": [station],
        "objective": {"effort_weight_s2_m2": 0.1, "cost_to_go": "connected"},
        "constraints": {"p_min": 0.8, "clearance_m": 1.5},
        "planner": {"name": "auto", "horizon": 10, "step_s": 2.0, "max_steps": 200},
    }
    return problem_from_tables(tables, folder=Path(), file=None)


def drive(
    problem: Problem, prepared: Prepared, next_m: Callable[[Any, Any], Any]
) -> tuple[np.ndarray, float]:
    """Return the positions (n + 1, 2) of a run, and the mean processor time of a step."""
    belief, here = prepared.belief, np.asarray(problem.robots[0].start_m, dtype=np.float64)
    away = float(np.linalg.norm(here - np.asarray(problem.goal_m)))
    most = int(LONGEST * away / problem.step_length_m)
    driven, spent_s = [here], 0.0
    while len(driven) <= most and not is_at_goal(problem, here):
        begun = process_time()
        here = np.asarray(next_m(belief, here), dtype=np.float64)
        spent_s += process_time() - begun
        driven.append(here)
        belief = learn_measured(
            problem, belief, [measure(truth, here[None]) for truth in prepared.truths]
        )
    return np.array(driven), spent_s / max(len(driven) - 1, 1)


def outside_steps(
    problem: Problem, scene: Scene, make: type[AStarPlanner], seed: int
) -> Callable[[Any, Any], Any]:
    """Return a function of belief and position: the first step of a planner's own path."""
    planner = make(problem, scene, np.random.default_rng(seed))
    region = workspace_region(problem)

    def next_m(belief: Any, here: Any) -> Any:
        context = verifier_context(problem, scene.index, belief.posteriors, here)
        return planner.path(step_context(context, region, Aim()))[0]

    return next_m


def own_steps(problem: Problem, scene: Scene) -> Callable[[Any, Any], Any]:
    """Return a function of belief and position: the first step of planopt's released plan."""
    planner, last = ReachPlanner(problem, scene), [None]

    def next_m(belief: Any, here: Any) -> Any:
        last[0] = planner.plan(belief, here, last[0])
        return last[0].positions_m[1]

    return next_m


def goals(first_seed: int, seeds: int) -> None:
    """Drive and print a row per map, then the means; planopt's losses are bold."""
    names = ["planopt", *OUTSIDE]
    print(f"| map | clairvoyant [m] | {' | '.join(names)} |\n|---|---|{'---|' * len(names)}")
    ratios: list[list[float]] = []
    times: list[list[float]] = []
    for seed in range(first_seed, first_seed + seeds):
        problem = random_map(seed)
        try:
            scene = build_scene(problem)
        except NoPlanError:
            print(f"| {seed} | no route |{' |' * len(names)}", flush=True)
            continue
        prepared = prepare(problem, seed)
        known = clairvoyant_path(problem, scene.road_map, scene.index, prepared.truths)
        least_m = realised_cost_m(problem, prepared.truths, known)
        steps = {"planopt": own_steps(problem, scene)}
        steps |= {n: outside_steps(problem, scene, make, seed) for n, make in OUTSIDE.items()}
        costs: list[float] = []
        spent: list[float] = []
        for next_m in steps.values():
            driven, step_s = drive(problem, prepared, next_m)
            arrived = is_at_goal(problem, driven[-1])
            cost = realised_cost_m(problem, prepared.truths, driven) / least_m
            costs.append(cost if arrived else np.inf)
            spent.append(step_s)
        cells = [f"{cost:.3f}" for cost in costs]
        if costs[0] > min(costs[1:]):
            cells[0] = f"**{cells[0]}**"
        print(f"| {seed} | {least_m:.0f} | {' | '.join(cells)} |", flush=True)
        ratios.append(costs)
        times.append(spent)
    table, step_ms = np.array(ratios), 1e3 * np.array(times)
    met = np.isfinite(table).all(axis=1)
    means = " | ".join(f"{mean:.3f}" for mean in table[met].mean(axis=0))
    print(f"| mean of {met.sum()} where all arrive | | {means} |")
    print(f"| arrived | | {' | '.join(str(n) for n in np.isfinite(table).sum(axis=0))} |")
    lost = (table[:, :1] > table).sum(axis=0)
    print(f"| maps where planopt costs more | | - | {' | '.join(map(str, lost[1:]))} |")
    mean_ms = " | ".join(f"{each:.0f}" for each in step_ms.mean(axis=0))
    print(f"| step [ms of processor time] | | {mean_ms} |")
    for name, other in zip(OUTSIDE, table[met].T[1:], strict=True):
        print(f"planopt - {name}: {interval(table[met, 0] - other)}")


def interval(values: np.ndarray) -> str:
    """Return the mean with its 95 % Student interval."""
    half = student.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
    return f"{values.mean():.3f} ({values.mean() - half:.3f} to {values.mean() + half:.3f})"


def tasks(
    files: list[str], planners: list[str], metric: str, first_seed: int, seeds: int, horizon: int
) -> None:
    """Simulate problems with planners by name, and print means and paired differences."""
    from planopt import load

    print(f"| problem | {' | '.join(planners)} | difference from {planners[0]} |")
    for file in files:
        values = np.empty((seeds, len(planners)))
        for column, name in enumerate(planners):
            problem = with_overrides(load(file), planner=name, horizon=horizon)
            for row in range(seeds):
                values[row, column] = simulate(problem, seed=first_seed + row).data["metrics"][
                    metric
                ]
        means = " | ".join(f"{mean:.3f}" for mean in values.mean(axis=0))
        paired = ", ".join(interval(other - values[:, 0]) for other in values.T[1:])
        print(f"| {file} | {means} | {paired} |", flush=True)


def main() -> None:
    """Drive and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=("goals", "tasks"))
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--problems", nargs="+", default=["outdoor_track"])
    parser.add_argument("--planners", nargs="+", default=["auto", "do_mpc"])
    parser.add_argument("--metric", default="mean_trace_m2")
    parser.add_argument("--horizon", type=int, default=10)
    asked = parser.parse_args()
    if asked.kind == "goals":
        return goals(asked.first_seed, asked.seeds)
    if "do_mpc" in asked.planners:
        from do_mpc_planner import DoMpcPlanner

        register_planner(PlannerKind("do_mpc", DoMpcPlanner))
    seeds = asked.first_seed, asked.seeds
    return tasks(asked.problems, asked.planners, asked.metric, *seeds, asked.horizon)


if __name__ == "__main__":
    main()
