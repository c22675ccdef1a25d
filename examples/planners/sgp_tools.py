"""SGP-Tools as a planner of mapping robots, in an environment of its own because of its NumPy.

``python -m venv sgp && sgp/bin/pip install sgptools`` makes the environment. Then
``SGP_PYTHON=sgp/bin/python python examples/planners/sgp_tools.py solve outdoor_map --planner
sgp_tools`` registers the planner and passes the arguments to planopt.

SGP-Tools optimises the inducing points of a sparse Gaussian process: they become waypoints. It gets
the fitted shadowing and multipath, the measured positions near the robot as points that are fixed,
and the length of N steps. It knows no obstacles: the robot stops before them.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from time import perf_counter
from typing import Any

import numpy as np

ENVIRONMENT = "SGP_PYTHON"
"""Environment variable with the interpreter that has SGP-Tools."""

MOST_POINTS, MOST_FIXED, MOST_ITERATIONS = 300, 40, 60
PAD_M = 2e-3


class SgpToolsPlanner:
    """Waypoints by sparse Gaussian processes, driven in straight lines at full speed."""

    def __init__(self, problem: Any, ground: Any, generator: Any = None) -> None:
        self.problem, self.ground = problem, ground
        self.generator = generator or np.random.default_rng(0)
        command = [os.environ.get(ENVIRONMENT, "python"), __file__, "--worker"]
        quiet = {**os.environ, "TF_CPP_MIN_LOG_LEVEL": "3", "CUDA_VISIBLE_DEVICES": "-1"}
        quiet.pop("PYTHONPATH", None)
        pipe = subprocess.PIPE
        self.worker = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True, env=quiet
        )

    def __del__(self) -> None:
        """Stop the worker."""
        if hasattr(self, "worker"):
            self.worker.terminate()

    def waypoints(self, context: Any) -> Any:
        """Return the waypoints (N, 2) that SGP-Tools finds from the robot's position on."""
        here, horizon = context.position_m, self.problem.planner.horizon
        budget_m = horizon * self.problem.step_length_m
        nodes, measured = self.ground.road_map.nodes_m, context.posterior.measurements.positions_m
        nodes = nodes[np.linalg.norm(nodes - here, axis=1) <= 1.2 * budget_m]
        if len(nodes) > MOST_POINTS:
            nodes = self.generator.choice(nodes, MOST_POINTS, replace=False)
        away = np.linalg.norm(measured - here, axis=1)
        near = measured[np.argsort(away)[:MOST_FIXED][::-1]]
        parameters = context.posterior.parameters
        asked = {
            "points": nodes.tolist(),
            "fixed": [*near.tolist(), here.tolist()],
            "count": horizon,
            "budget_m": budget_m,
            "variance": parameters.shadow_std_db**2,
            "noise": parameters.multipath_std_db**2,
            "length_m": parameters.decorrelation_m,
            "iterations": MOST_ITERATIONS,
        }
        assert self.worker.stdin is not None and self.worker.stdout is not None
        self.worker.stdin.write(json.dumps(asked) + "\n")
        self.worker.stdin.flush()
        answer = self.worker.stdout.readline()
        if not answer:
            raise RuntimeError(f"{ENVIRONMENT} names no interpreter with SGP-Tools")
        return np.array(json.loads(answer))

    def plan(self, context: Any, scorer: Any, warm: Any = None) -> Any:
        """Return the plan, which planopt verifies."""
        from planopt.extend import released
        from planopt.world import segments_clear

        begun, step_m = perf_counter(), self.problem.step_length_m * (1.0 - 1e-6)
        low, high = np.reshape(self.problem.workspace.bounds_m, (2, 2))
        required_m = self.problem.constraints.clearance_m + PAD_M
        route, path = list(np.clip(self.waypoints(context), low, high)), [context.position_m]
        while len(path) <= self.problem.planner.horizon:
            here = path[-1]
            while route and np.linalg.norm(route[0] - here) < 1e-6:
                route.pop(0)
            end = here
            if route:
                away = route[0] - here
                end = here + away * min(1.0, step_m / float(np.linalg.norm(away)))
            if not segments_clear(self.ground.index, here[None], end[None], required_m)[0]:
                route.pop(0)
                continue
            path.append(end)
        return released(scorer, np.array(path[1:]), begun)


def work() -> None:
    """Answer requests, one JSON object a line, in the environment of SGP-Tools."""
    from gpflow.kernels import Exponential
    from sgptools.core.transformations import IPPTransform
    from sgptools.methods import ContinuousSGP

    answers, sys.stdout = sys.stdout, sys.stderr
    for line in sys.stdin:
        asked = json.loads(line)
        points, fixed = (np.array(asked[key], dtype=float) for key in ("points", "fixed"))
        # GPflow's kernel is exp(-r / 2) of the scaled distance r.
        kernel = Exponential(variance=asked["variance"], lengthscales=0.5 * asked["length_m"])
        driven_m = float(np.linalg.norm(np.diff(fixed, axis=0), axis=1).sum())
        here, count = fixed[-1], asked["count"]
        # The first guess is a straight line to the farthest point.
        far = points[np.linalg.norm(points - here, axis=1).argmax()]
        away = far - here
        away *= min(1.0, asked["budget_m"] / float(np.linalg.norm(away)))
        guess = here + np.arange(1, count + 1)[:, None] / count * away
        transform = IPPTransform(
            num_robots=1,
            distance_budget=asked["budget_m"] + driven_m,
            Xu_fixed=fixed[None],
            constraint_weight=100.0,
        )
        method = ContinuousSGP(
            count + len(fixed),
            points,
            kernel,
            max(asked["noise"], 1e-3),
            transform=transform,
            X_init=np.vstack([fixed, guess]),
        )
        found = method.optimize(max_steps=asked["iterations"])[0, len(fixed) :]
        answers.write(json.dumps(found.tolist()) + "\n")
        answers.flush()


if __name__ == "__main__":
    if "--worker" in sys.argv:
        work()
    else:
        from planopt.cli import main
        from planopt.extend import PlannerKind, register_planner

        register_planner(PlannerKind("sgp_tools", SgpToolsPlanner))
        sys.exit(main())
