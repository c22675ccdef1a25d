"""Optimality gaps of the objective, of plan and route, and of driven runs with a goal.

The bound is that of the first plan (equation 6.14). The driven path is charged with the outage of
the belief at the start, for which the bound holds, integrated along the path.
Run: python benchmarks/route_gaps.py open_field munich_courier --seed 0 --prove 10
"""

import argparse

import numpy as np

import planopt
from planopt.planning.proof.bounds import metre_cost_of
from planopt.problems.problem import integrated_cost_m, rate_s_m, steps_cost_s


def main() -> None:
    """Print one row per problem."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="+")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--prove", type=float, default=10.0)
    arguments = parser.parse_args()
    print("| problem | bound, s | objective, % | plan and route, % | driven run, % | outcome |")
    print("|---|---|---|---|---|---|")
    for name in arguments.problems:
        problem = planopt.load(name)
        solution = planopt.solve(problem, seed=arguments.seed, prove_s=arguments.prove)
        bound, plan = solution.plan.bound, solution.plan
        assert bound is not None
        assert bound.value is not None
        run = planopt.simulate(problem, seed=arguments.seed).run
        places = run.log.positions_m
        lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
        metre_cost = metre_cost_of(problem, solution.belief.posteriors)
        outage_m = integrated_cost_m(metre_cost, places) - lengths.sum()
        driven_s = steps_cost_s(problem, places) + rate_s_m(problem) * outage_m
        gaps = [
            f"{100 * (cost / bound.value - 1):.2f}"
            for cost in (plan.objective, bound.cost, driven_s)
        ]
        print(
            f"| `{name}` | {bound.value:.2f} |",
            " | ".join(gaps),
            f"| {run.outcome.value} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
