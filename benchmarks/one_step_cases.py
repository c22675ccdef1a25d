"""One-step problems (2), (3) and (4) of [GM11] as printed, solved to proven optimality.

Run from the project's root: python benchmarks/one_step_cases.py --seeds 20
(2) is in the indoor scene of fig2, (3) in the outdoor scene of fig3 (sigma_TH^2 = 4 dB^2, zeta =
0.01 / m), (4) in outdoor_track. A seed draws start, measurements and target. Problem (3) has two
parts: the best position of the workspace, and the nearest reachable position.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

import planopt
from planopt.bounds.bound import Design
from planopt.bounds.one_step import BestPlace, best_place
from planopt.bounds.stages import stage_problem, summed_terms
from planopt.bounds.tube import StageProblem
from planopt.objectives.upper_bounds import Field, UpperBounds
from planopt.planning.initial_data import prepare
from planopt.planning.proof.rule import verifier_context
from planopt.planning.solve import solve_on
from planopt.planning.values.context import step_context, workspace_region
from planopt.world.clearance import index_obstacles


def one_step(name: str, seed: int, **changes: object) -> StageProblem:
    """The one-step problem of a library problem's first robot."""
    problem = planopt.load(name)
    term = replace(problem.terms[0], **changes)
    problem = replace(
        problem,
        robots=problem.robots[:1],
        objective=planopt.objectives.TermsObjective((term,)),
        planner=replace(problem.planner, horizon=1),
    )
    solution = solve_on(problem, prepare(problem, seed, None).belief, seed)
    here, problem = solution.plans[0].positions_m[0], solution.problem
    base = verifier_context(
        problem, index_obstacles(problem.workspace), solution.belief.posteriors, here
    )
    at = step_context(base, workspace_region(problem), solution.aims[0])
    terms, kept = summed_terms(problem, at), np.zeros(1, dtype=bool)
    stages = stage_problem(problem, at, terms, kept, Design())
    return replace(stages, step_m=at.step_length_m)


def nearest_to(problem: StageProblem, goal_m: np.ndarray) -> StageProblem:
    """The problem of the reachable position nearest to a position (2,)."""

    def reward(stage: int, field: Field) -> UpperBounds:
        offset = field.discs.centre_m - goal_m
        distance = np.hypot(*offset.T)
        slope = -offset / np.maximum(distance, 1e-300)[:, None]
        least = np.maximum(distance - field.discs.radius_m, 0.0)
        return UpperBounds(-distance, slope, -least, field.discs.radius_m)

    return replace(problem, reward=reward, sure_m=np.zeros((0, 2)))


def cases(seed: int) -> dict[str, BestPlace]:
    """The solutions of all problems for a seed."""
    learning = one_step("fig2", seed, criterion="T")
    mapping = one_step("fig3", seed, form="path", variance_threshold_db2=4.0, closeness_per_m=0.01)
    x0, y0, x1, y1 = mapping.limits_m[0]
    everywhere = replace(mapping, step_m=float(np.hypot(x1 - x0, y1 - y0)))
    found = {"(2)": best_place(learning, 60.0), "(3) position": best_place(everywhere, 60.0)}
    target = found["(3) position"].place_m
    found["(3) step"] = best_place(nearest_to(mapping, target), 60.0)
    found["(4)"] = best_place(one_step("outdoor_track", seed), 60.0)
    return found


def main() -> None:
    """Print time and gap of each problem for each seed, and their largest values."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=20)
    given = parser.parse_args()
    rows: dict[str, list[tuple[float, float]]] = {}
    for seed in range(given.first_seed, given.first_seed + given.seeds):
        for name, best in cases(seed).items():
            rows.setdefault(name, []).append((best.seconds, best.gap))
            print(
                seed,
                name,
                f"{best.seconds:.2f} s, gap {best.gap:.2g}, value {best.value:.6g}",
                flush=True,
            )
    for name, each in rows.items():
        seconds, gaps = np.array(each).T
        times = f"median {np.median(seconds):.2f} s, longest {seconds.max():.2f} s"
        print(f"{name}: {times}, largest gap {gaps.max():.2g}")


if __name__ == "__main__":
    main()
