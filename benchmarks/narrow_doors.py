"""Planning through doors of random position, angle and width, compared with proven bounds.

Each scene has one wall through the workspace with a door 1.05 to 2 times as wide as twice the
clearance; there is no other route. The cost of plan and route is compared with the proven bound.
Run: python benchmarks/narrow_doors.py --first-seed 1000 --scenes 20
"""

import argparse
from dataclasses import replace

import numpy as np
import shapely

import planopt
from planopt.problems.problem import Problem
from planopt.world.workspace import Obstacle, Workspace

SIDES_M = (100.0, 80.0)


def door_problem(seed: int) -> Problem:
    """Return a problem whose only route leads through a narrow door."""
    generator = np.random.default_rng(seed)
    clearance, step = generator.uniform(0.4, 2.0), generator.uniform(2.0, 6.0)
    wide = 2.0 * clearance * generator.uniform(1.05, 2.0)
    thick, angle = generator.uniform(0.2, 6.0), generator.uniform(0.0, np.pi)
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    door = 0.5 * np.array(SIDES_M) + generator.uniform(-12.0, 12.0, 2)
    sides = []
    for side in (1.0, -1.0):
        near, far = (door + side * away * along for away in (0.5 * wide, 300.0))
        corners = [each + share * thick * across for each in (near, far) for share in (-0.5, 0.5)]
        sides.append(Obstacle("wall", shapely.MultiPoint(corners).convex_hull))
    places = [
        door + sign * generator.uniform(12, 20) * across + generator.uniform(-8, 8) * along
        for sign in (1.0, -1.0)
    ]
    start, goal = (tuple(np.clip(place, 4.0, np.array(SIDES_M) - 4.0)) for place in places)
    problem = planopt.load("gap_two_doors")
    robot = replace(problem.robots[0], start_m=start, goal_m=goal, speed_max_m_s=0.5 * step)
    return replace(
        problem,
        name=f"door_{seed}",
        workspace=Workspace((0.0, 0.0, *SIDES_M), tuple(sides)),
        robots=(robot,),
        constraints=replace(problem.constraints, clearance_m=clearance),
    )


def main() -> None:
    """Print each scene's verdict, cost and gap."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--prove", type=float, default=2.0)
    arguments = parser.parse_args()
    gaps, verdicts = [], []
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.scenes):
        problem = door_problem(seed)
        try:
            plan = planopt.solve(problem, horizon=10, seed=seed).plan
        except planopt.NoPlanError as error:
            print(seed, error, flush=True)
            continue
        proven = planopt.solve(problem, horizon=10, seed=seed, prove_s=arguments.prove).plan
        assert proven.bound is not None
        assert proven.bound.value is not None
        verdicts.append(plan.verdict.value)
        gaps.append(plan.objective / proven.bound.value - 1.0)
        print(seed, plan.verdict.value, f"{plan.objective:.1f} s, {gaps[-1]:.1%}", flush=True)
    print(f"{len(gaps)} of {arguments.scenes} with a plan, verified {verdicts.count('verified')}")
    print(f"gap: median {np.median(gaps):.1%}, largest {max(gaps):.1%}")


if __name__ == "__main__":
    main()
