"""How long steps take under a deadline, over the library's motion problems.

``python benchmarks/step_deadlines.py --budget 0.5 --seeds 1 --log FILE`` drives each problem with a
deadline and without, appends a line a run to the log, and prints the table. The log is a cache:
runs that it has are not driven again. Times are wall times: run it on an idle machine, or with
``--processor-time`` on a shared one. ``--problems`` takes names of `STRESS` as well: scenes larger
than those of the library.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

if "--processor-time" in sys.argv:
    # Before planopt takes the clock: deadlines and step times are then of the processor.
    time.perf_counter = time.process_time

from courier_teams import drawn_problem

from planopt import NoPlanError, Problem, load, simulate
from planopt.planning.loop.results import summary_of
from planopt.problems.tasks import MOTION
from planopt.studies.bench_cases import library_names

STRESS_STEPS = 12
"""Steps of a run of a larger scene."""

LATE_SHARE = 1.2
"""A step is late that takes more than this share of the deadline."""

HEADER = (
    "| problem | steps | without deadline: p50, p95, max [ms] | verified [%] "
    "| with it: p50, p95, max [ms] | late steps | verified [%] |\n|---|---|---|---|---|---|---|"
)


def longer(name: str, horizon: int) -> Problem:
    """A problem of the library that looks farther ahead."""
    problem = load(name)
    return replace(problem, planner=replace(problem.planner, horizon=horizon))


def thrice(name: str) -> Problem:
    """A problem of the library with every obstacle three times."""
    problem = load(name)
    every = [
        replace(one, name=f"{one.name} {copy}")
        for copy in range(3)
        for one in problem.workspace.obstacles
    ]
    return replace(problem, workspace=replace(problem.workspace, obstacles=tuple(every)))


def unsure(name: str, p_min: float) -> Problem:
    """A problem of the library with a bound for which all parameters count as uncertain."""
    problem = load(name)
    rule = replace(problem.constraints.rule, parameter_uncertainty="all")
    return replace(problem, constraints=replace(problem.constraints, p_min=p_min, rule=rule))


def couriers(count: int) -> Problem:
    """So many couriers between drawn places of one square in Munich."""
    return drawn_problem(load("munich_courier"), count, seed=0)


STRESS: dict[str, Callable[[], Problem]] = {
    "munich_hard_20": lambda: longer("munich_hard", 20),
    "connect_street_20": lambda: longer("connect_street", 20),
    "connect_rooftop_20": lambda: longer("connect_rooftop", 20),
    "couriers_5": lambda: couriers(5),
    "two_station_courier_thrice": lambda: thrice("two_station_courier"),
    "harbour_traffic_unsure": lambda: unsure("harbour_traffic", 0.8),
}
"""Scenes that are larger than those of the library, by name."""


def scene(name: str) -> Problem:
    """A problem of the library, or the first steps of one of `STRESS`."""
    if name not in STRESS:
        return load(name)
    problem = STRESS[name]()
    return replace(problem, planner=replace(problem.planner, max_steps=STRESS_STEPS))


@dataclass(frozen=True)
class Timed:
    """One run.

    Attributes
    ----------
    problem, seed, budget_s
        What was driven; no deadline is None.
    step_s
        Wall time that each step of each robot took to plan.
    verified_rate
        Share of the steps whose plan was verified.
    """

    problem: str
    seed: int
    budget_s: float | None
    step_s: list[float]
    verified_rate: float


def timed(name: str, seed: int, budget_s: float | None) -> Timed | None:
    """Drive one problem; None if there is no path to its goal."""
    problem = scene(name)
    hurried = replace(problem, planner=replace(problem.planner, budget_s=budget_s))
    try:
        found = summary_of(simulate(hurried, seed=seed))
    except NoPlanError:
        return None
    return Timed(name, seed, budget_s, [float(each) for each in found.step_s], found.verified_rate)


def read_log(log: Path) -> list[Timed]:
    """The runs of a log."""
    if not log.exists():
        return []
    return [Timed(**json.loads(line)) for line in log.read_text(encoding="utf-8").splitlines()]


def line_of(label: str, records: Sequence[Timed], budget_s: float) -> str:
    """A line of the table over some runs, with the deadline and without."""
    free = [each for each in records if each.budget_s is None]
    held = [each for each in records if each.budget_s == budget_s]
    late = sum(step > LATE_SHARE * budget_s for each in held for step in each.step_s)
    steps = sum(len(each.step_s) for each in held)
    return (
        f"| {label} | {steps} | {_times(free)} | {_verified(free)} "
        f"| {_times(held)} | {late} | {_verified(held)} |"
    )


def _times(records: Sequence[Timed]) -> str:
    step_ms = 1e3 * np.concatenate([each.step_s for each in records])
    return f"{np.median(step_ms):.0f}, {np.quantile(step_ms, 0.95):.0f}, {step_ms.max():.0f}"


def _verified(records: Sequence[Timed]) -> str:
    steps = np.array([len(each.step_s) for each in records])
    rates = np.array([each.verified_rate for each in records])
    return f"{100.0 * float(steps @ rates) / steps.sum():.1f}"


def main() -> None:
    """Drive and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", nargs="+")
    parser.add_argument("--budget", type=float, default=0.5)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--processor-time", action="store_true")
    asked = parser.parse_args()
    names = asked.problems or library_names(MOTION)
    known = {(each.problem, each.seed, each.budget_s) for each in read_log(asked.log)}
    for seed in range(asked.first_seed, asked.first_seed + asked.seeds):
        for name in names:
            for budget_s in (None, asked.budget):
                if (name, seed, budget_s) in known:
                    continue
                record = timed(name, seed, budget_s)
                if record is None:
                    break
                with asked.log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(record)) + "\n")
    records = [each for each in read_log(asked.log) if each.problem in names]
    print(HEADER)
    for name in sorted({each.problem for each in records}):
        print(line_of(name, [each for each in records if each.problem == name], asked.budget))
    print(line_of("all", records, asked.budget))


if __name__ == "__main__":
    main()
