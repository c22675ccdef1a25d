"""Optimality gaps of the objective, of plan and route, and of driven runs with a goal.

The bound is that of the first plan (equation 6.14). The driven path is charged with the outage of
the belief at the start, for which the bound holds, integrated along the path.
Run: python benchmarks/route_gaps.py open_field munich_courier --seed 0 --prove 10
`NAME:SEED` draws start and goal at random, at least 150 m (half the map's diagonal, if less) apart
and 4 m from every obstacle. With `--cpu`, times are processor times, and solves are
not interrupted, since the solver's own limit is wall time.
"""

import argparse
from dataclasses import replace
from time import process_time

import numpy as np

import planopt
from planopt.bounds import fixed_steps, route
from planopt.planning import prove
from planopt.planning.proof.bounds import metre_cost_of
from planopt.problems.problem import integrated_cost_m, rate_s_m, steps_cost_s
from planopt.world.clearance import clearance_m, index_obstacles


def named(name: str) -> planopt.Problem:
    """A library problem, with random end points for `NAME:SEED`."""
    name, _, seed = name.partition(":")
    problem = planopt.load(name)
    if not seed:
        return problem
    generator, index = np.random.default_rng(int(seed)), index_obstacles(problem.workspace)
    low, high = np.reshape(problem.workspace.bounds_m, (2, 2))
    while True:
        ends = generator.uniform(low, high, (2, 2))
        apart = np.linalg.norm(ends[1] - ends[0]) >= min(150.0, 0.5 * np.hypot(*(high - low)))
        if not apart or clearance_m(index, ends).min() < 4.0:
            continue
        robot = replace(problem.robots[0], start_m=tuple(ends[0]), goal_m=tuple(ends[1]))
        try:
            planopt.solve(replace(problem, robots=(robot,)), horizon=1)
        except planopt.NoPlanError:
            continue
        return replace(problem, robots=(robot,))


def main() -> None:
    """Print one row per problem."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="+")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--prove", type=float, default=10.0)
    parser.add_argument("--cpu", action="store_true")
    parser.add_argument("--plan-only", action="store_true")
    arguments = parser.parse_args()
    if arguments.cpu:
        solve = route._best_potential
        route._best_potential = lambda *given: solve(*given[:-1], 60.0)
        route.monotonic = fixed_steps.monotonic = prove.monotonic = process_time
    print("| problem | bound, s | objective, % | plan and route, % | driven run, % | outcome |")
    print("|---|---|---|---|---|---|")
    for name in arguments.problems:
        problem = named(name)
        solution = planopt.solve(problem, seed=arguments.seed, prove_s=arguments.prove)
        bound, plan = solution.plan.bound, solution.plan
        assert bound is not None
        assert bound.value is not None
        gaps = [f"{100 * (cost / bound.value - 1):.2f}" for cost in (plan.objective, bound.cost)]
        if arguments.plan_only:
            print(f"| `{name}` | {bound.value:.2f} |", " | ".join(gaps), "| | |", flush=True)
            continue
        run = planopt.simulate(problem, seed=arguments.seed).run
        places = run.log.positions_m
        lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
        metre_cost = metre_cost_of(problem, solution.belief.posteriors)
        outage_m = integrated_cost_m(metre_cost, places) - lengths.sum()
        driven_s = steps_cost_s(problem, places) + rate_s_m(problem) * outage_m
        gaps.append(f"{100 * (driven_s / bound.value - 1):.2f}")
        print(
            f"| `{name}` | {bound.value:.2f} |",
            " | ".join(gaps),
            f"| {run.outcome.value} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
