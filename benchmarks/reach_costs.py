"""What runs to a goal cost against one who knows the map, over the library's reach problems.

``python benchmarks/reach_costs.py --first-seed 100 --seeds 10 --log FILE`` drives each problem of
the library that has a goal and a free path, appends a line a run to the log, and prints the table.
The log is a cache: runs that it has are not driven again. ``--problems A B`` names some of them.
Beside each run the plain courier (``plain_courier.py``) drives the same seed, once on its belief
and once knowing the mean power: a second table tells what planning and what knowledge cost.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray
from plain_courier import drive_plain

from planopt import NoPlanError, load
from planopt.objectives import ReachObjective
from planopt.planning.initial_data import prepare
from planopt.planning.loop.metrics import clairvoyant_path, realised_cost_m
from planopt.planning.scene import build_scene
from planopt.planning.solve import simulate
from planopt.problems.objective import OutageCharge
from planopt.problems.tasks import MOTION
from planopt.studies.bench_cases import library_names
from planopt.studies.comparison import mean_interval

HEADER = (
    "| problem | arrived | driven / clairvoyant length | cost ratio, mean | worst | verified [%] "
    "| below p_min [%] | step p50, max [ms] |\n|---|---|---|---|---|---|---|---|"
)


PAIRED_HEADER = (
    "| problem | runs | cost ratio | plain courier | difference | worst of both | plain length "
    "| plain knowing the mean power |\n|---|---|---|---|---|---|---|---|"
)


@dataclass(frozen=True)
class Record:
    """One run.

    Attributes
    ----------
    problem, seed, outcome
        What was driven and how it ended.
    driven_m, clairvoyant_m
        Lengths of the run and of the clairvoyant's path.
    cost_ratio
        Realised cost over the clairvoyant's; NaN where the run did not arrive.
    steps, verified_steps, below_steps
        Steps, those whose plan was verified, those predicted below `p_min` by their plan.
    step_p50_s, step_max_s
        Wall time of the steps.
    plain_m, plain_cost_ratio
        Of the plain courier with the same seed.
    knowing_cost_ratio
        Of the plain courier that knows the mean power.
    """

    problem: str
    seed: int
    outcome: str
    driven_m: float
    clairvoyant_m: float
    cost_ratio: float
    steps: int
    verified_steps: int
    below_steps: int
    step_p50_s: float
    step_max_s: float
    plain_m: float
    plain_cost_ratio: float
    knowing_cost_ratio: float


def reach_problems() -> list[str]:
    """Names of the library's problems of one robot that have a goal and a path to it.

    Problems with a hard chance constraint may have no plan to begin with and are left out.
    """
    names: list[str] = []
    for name in library_names(MOTION):
        problem = load(name)
        hard = problem.constraints.rule.slack_max_db is not None
        if problem.task != "reach" or len(problem.robots) > 1 or hard:
            continue
        try:
            build_scene(problem)
        except NoPlanError:
            continue
        names.append(name)
    return names


def drive(name: str, seed: int, horizon: int, charge: OutageCharge) -> Record:
    """Drive one problem of the library with one seed, the outage price charged as `charge` says."""
    problem = load(name)
    problem = replace(problem, objective=replace(problem.reach, outage_charge=charge))
    scene, prepared = build_scene(problem), prepare(problem, seed)
    simulation = simulate(problem, horizon=horizon, seed=seed, scenes=[scene], prepared=prepared)
    run = simulation.run
    known = clairvoyant_path(problem, scene.road_map, scene.index, prepared.truths)
    least_m = realised_cost_m(problem, prepared.truths, known)
    plain, knowing = (
        drive_plain(problem, scene, prepared, sees_m=sees_m) for sees_m in (0.0, np.inf)
    )
    below = run.log.connectivity[1:] < problem.constraints.p_min
    return Record(
        problem=name,
        seed=seed,
        outcome=run.outcome.value,
        driven_m=run.metrics.path_m,
        clairvoyant_m=_length_m(known),
        cost_ratio=simulation.costs["cost_ratio"],
        steps=len(below),
        verified_steps=round(run.verified_rate * len(below)),
        below_steps=int(below.sum()),
        step_p50_s=float(np.median(run.log.step_s[1:])),
        step_max_s=float(run.log.step_s[1:].max()),
        plain_m=_length_m(plain),
        plain_cost_ratio=realised_cost_m(problem, prepared.truths, plain) / least_m,
        knowing_cost_ratio=realised_cost_m(problem, prepared.truths, knowing) / least_m,
    )


def _length_m(places_m: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.diff(places_m, axis=0), axis=1).sum())


def read_log(log: Path) -> list[Record]:
    """The runs of a log."""
    if not log.exists():
        return []
    return [Record(**json.loads(line)) for line in log.read_text(encoding="utf-8").splitlines()]


def line_of(label: str, records: Sequence[Record]) -> str:
    """A line of the table over some runs.

    Runs of one seed belong together: the interval of the mean is over seeds, from five on.
    """
    arrived = [each for each in records if each.outcome == "reached"]
    ratios = np.array([each.cost_ratio for each in arrived])
    lengths = np.array([each.driven_m / each.clairvoyant_m for each in arrived])
    steps = sum(each.steps for each in records)
    mean = worst = length = "-"
    if len(arrived):
        mean = _mean_over_seeds(ratios, [each.seed for each in arrived])
        worst = f"{ratios.max():.3f}"
        length = f"{lengths.mean():.3f}"
    p50 = float(np.median([each.step_p50_s for each in records]))
    return (
        f"| {label} | {len(arrived)} of {len(records)} | {length} | {mean} | {worst} "
        f"| {100 * sum(each.verified_steps for each in records) / steps:.1f} "
        f"| {100 * sum(each.below_steps for each in records) / steps:.1f} "
        f"| {1e3 * p50:.0f}, {1e3 * max(each.step_max_s for each in records):.0f} |"
    )


def paired_line_of(label: str, records: Sequence[Record]) -> str:
    """A line of the table that compares with the plain courier, over runs that arrived."""
    arrived = [each for each in records if each.outcome == "reached"]
    if not arrived:
        return f"| {label} | 0 | - | - | - | - | - | - |"
    seeds = [each.seed for each in arrived]
    ours, plain = (
        np.array([getattr(each, key) for each in arrived])
        for key in ("cost_ratio", "plain_cost_ratio")
    )
    lengths = np.array([each.plain_m / each.clairvoyant_m for each in arrived])
    knowing = np.array([each.knowing_cost_ratio for each in arrived])
    return (
        f"| {label} | {len(arrived)} | {ours.mean():.3f} | {plain.mean():.3f} "
        f"| {_mean_over_seeds(ours - plain, seeds)} | {ours.max():.3f}, {plain.max():.3f} "
        f"| {lengths.mean():.3f} | {knowing.mean():.3f} |"
    )


def _mean_over_seeds(values: NDArray[np.float64], seeds: Sequence[int]) -> str:
    """The mean, with the interval over seeds where there are five."""
    each = np.array(seeds)
    low, high = mean_interval(np.array([values[each == seed].mean() for seed in np.unique(each)]))
    within = "" if low is None or high is None else f" ({low:.3f} to {high:.3f})"
    return f"{values.mean():.3f}{within}"


def table(records: Sequence[Record]) -> str:
    """A line a problem in order of name, and one over all; of both tables."""
    names = sorted({each.problem for each in records})
    parts = [(name, [each for each in records if each.problem == name]) for name in names]
    parts.append(("all", list(records)))
    costs = [HEADER, *(line_of(label, part) for label, part in parts)]
    paired = [PAIRED_HEADER, *(paired_line_of(label, part) for label, part in parts)]
    return "\n".join([*costs, "", *paired])


def main() -> None:
    """Drive and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", nargs="+")
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--horizon", type=int, default=10)
    parser.add_argument(
        "--charge", default=ReachObjective.outage_charge, choices=get_args(OutageCharge)
    )
    parser.add_argument("--log", type=Path, required=True)
    asked = parser.parse_args()
    names = asked.problems or reach_problems()
    known = {(each.problem, each.seed) for each in read_log(asked.log)}
    for seed in range(asked.first_seed, asked.first_seed + asked.seeds):
        for name in names:
            if (name, seed) in known:
                continue
            record = drive(name, seed, asked.horizon, asked.charge)
            with asked.log.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(record)) + "\n")
    print(table([each for each in read_log(asked.log) if each.problem in names]))


if __name__ == "__main__":
    main()
