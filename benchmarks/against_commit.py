"""Closed loops of an earlier commit and of the current code on the same seeds, step by step.

``git worktree add --detach OLD 52f8475``, ``python benchmarks/against_commit.py --old OLD``.
Both load the earlier commit's problem files and draw the same ground truth. Their steps take turns,
so that the ratio of their processor times holds on a busy machine too.

``--times`` compares only the processor times of planning steps (median and 95 % quantile), also of
problems without a goal. Each code then loads its own problem of a name and plans through
:class:`planopt.Planner`; the readings are its own predictions.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

TIMED_STEPS = 40
"""Steps after the first, which fills the map, whose times are compared."""

PROBLEMS = ("harbour_reach", "munich_courier", "munich_hard", "open_field", "two_station_courier")

TIMED = (
    *("munich_courier:1", "munich_courier:10", "munich_courier:20", "open_field", "harbour_reach"),
    *("outdoor_track", "fig4", "indoor_learn", "fig2", "outdoor_map", "connect_rooftop"),
)
"""Problems, with a horizon where it is not their own, whose planning steps are timed."""


def drive(file: str, seed: int, horizon: int, charge: str) -> None:
    """Drive in whichever code is imported: a line out after each step, one in before the next."""
    import planopt

    problem: Any = planopt.load(file)
    if horizon:
        problem = replace(problem, planner=replace(problem.planner, horizon=horizon))
    if charge:
        problem = replace(problem, objective=replace(problem.objective, outage_charge=charge))
    begun_s = process_time()

    def stepped(_: int) -> None:
        nonlocal begun_s
        print(process_time() - begun_s, flush=True)
        sys.stdin.readline()
        begun_s = process_time()

    run: Any = planopt.simulate(problem, seed=seed, on_step=stepped)
    log = run.run.log
    record = {
        "arrived": run.run.outcome.value == "reached",
        "track_m": log.positions_m.tolist(),
        "below": int((log.connectivity[1:] < problem.constraints.p_min).sum()),
    }
    print(json.dumps(record), flush=True)


def time_steps(name: str, seed: int, horizon: int) -> None:
    """Plan in whichever code is imported: a line out after each step, one in before the next."""
    import planopt

    problem: Any = planopt.load(Path(planopt.__file__).parents[1] / "problems" / f"{name}.toml")
    planner: Any = planopt.Planner(problem, horizon=horizon or None, seed=seed)
    robots = planner.problem.robots
    states = [robot.start_state for robot in robots]
    readings: list[Any] = [None] * len(robots)
    for _ in range(TIMED_STEPS + 1):
        begun_s = process_time()
        plans = planner.step_all(states, readings, connected=[True] * len(robots))
        print(process_time() - begun_s, flush=True)
        sys.stdin.readline()
        states = [plan.next_state for plan in plans]
        readings = [_expected(planner.beliefs[0], state[:2]) for state in states]
    print(json.dumps({}), flush=True)


def _expected(belief: Any, place_m: Any) -> Any:
    """Return the predicted powers of all stations at a place as measurements."""
    from planopt import Measurements

    means = [each.predict([place_m]).mean_db for each in belief.posteriors]
    taken = [Measurements(np.array([place_m]), mean) for mean in means]
    return taken[0] if len(taken) == 1 else taken


def drive_both(
    old: Path, file: Path | str, seed: int, horizon: int, charge: str, task: str = "--drive"
) -> list[dict[str, Any]]:
    """Drive both codes in turn; the earlier one's run first, each with the times of its steps."""
    here = Path(__file__).resolve()
    with ExitStack() as both:
        runs: list[subprocess.Popen[str]] = []
        for tree, charged in ((old, ""), (here.parents[1], charge)):
            asked = [str(file), str(seed), str(horizon), charged]
            alone = {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
            run = subprocess.Popen(
                [sys.executable, str(here), task, *asked],
                env=os.environ | alone,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            runs.append(both.enter_context(run))
        said = [_answer(run, None) for run in runs]
        step_s: list[list[float]] = [[], []]
        while any(isinstance(each, float) for each in said):
            for k, run in enumerate(runs):
                if isinstance(said[k], float):
                    said[k] = _answer(run, "\n")
                    step_s[k].append(said[k])
    return [each | {"step_s": times[:-1]} for each, times in zip(said, step_s, strict=True)]


def _answer(run: subprocess.Popen[str], question: str | None) -> Any:
    """Let a run take its next step: its processor time, or the record of the whole run."""
    if run.stdin is None or run.stdout is None:
        raise AssertionError("runs are piped")
    if question is not None:
        run.stdin.write(question)
        run.stdin.flush()
    return json.loads(run.stdout.readline())


def out_m(file: Path, seed: int, track_m: list[Any]) -> tuple[float, float]:
    """Length of a track, and how many metres of it are truly out of contact."""
    from planopt import load
    from planopt.planning.initial_data import prepare
    from planopt.planning.loop.metrics import realised_cost_m

    problem, track = load(file), np.array(track_m)
    length = float(np.linalg.norm(np.diff(track, axis=0), axis=1).sum())
    cost = realised_cost_m(problem, prepare(problem, seed).truths, track)
    return length, (cost - length) / problem.reach.outage_price


def compare_times(old: Path, names: Sequence[str], seeds: Sequence[int]) -> None:
    """Print the median and the 95 % quantile of the planning steps' processor times."""
    print("| problem | p50 [ms] | ratio | p95 [ms] | ratio |\n|---|---|---|---|---|")
    for entry in names:
        name, _, horizon = entry.partition(":")
        both: list[list[float]] = [[], []]
        for seed in seeds:
            runs = drive_both(old, name, seed, int(horizon or 0), "", "--time-steps")
            for times, run in zip(both, runs, strict=True):
                times += run["step_s"]
        cells = [f"{name}, N = {horizon}" if horizon else name]
        for quantile in (0.5, 0.95):
            before, now = (1e3 * float(np.quantile(times, quantile)) for times in both)
            cells += [f"{before:.1f}, {now:.1f}", f"{now / before:.2f}"]
        print(f"| {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Drive and print a row for each problem."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--old", type=Path, required=True, help="work tree of the earlier commit")
    parser.add_argument("--problems", nargs="+", help="NAME, or with --times NAME:HORIZON")
    parser.add_argument("--times", action="store_true", help="compare only times of planning")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--horizon", type=int, default=0, help="0 for each problem's own")
    parser.add_argument("--charge", default="", help="outage_charge of the current code")
    asked = parser.parse_args()
    old = asked.old.resolve()
    seeds = range(asked.first_seed, asked.first_seed + asked.seeds)
    if asked.times:
        compare_times(old, asked.problems or TIMED, seeds)
        return
    print("| problem | arrived | length [m] | out of contact [m] | below p_min [%] | step ratio |")
    print("|---|---|---|---|---|---|")
    for name in asked.problems or PROBLEMS:
        file = old / "problems" / f"{name}.toml"
        rows: list[Any] = []
        ratios: list[float] = []
        for seed in seeds:
            runs = drive_both(old, file, seed, asked.horizon, asked.charge)
            timed = zip(*(run["step_s"][:TIMED_STEPS] for run in runs), strict=False)
            ratios.append(float(np.median([new / before for before, new in timed])))
            rows.append(
                [
                    (run["arrived"], *out_m(file, seed, run["track_m"]), run["below"], steps)
                    for run in runs
                    for steps in [len(run["track_m"]) - 1]
                ]
            )
        arrived, length, out, below, steps = np.array(rows, dtype=float).sum(axis=0).T
        print(
            f"| {name} | {arrived[0]:.0f}, {arrived[1]:.0f} of {asked.seeds} "
            f"| {length[0] / asked.seeds:.0f}, {length[1] / asked.seeds:.0f} "
            f"| {out[0] / asked.seeds:.1f}, {out[1] / asked.seeds:.1f} "
            f"| {100 * below[0] / steps[0]:.2f}, {100 * below[1] / steps[1]:.2f} "
            f"| {np.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f}) |",
            flush=True,
        )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--drive"]:
        drive(sys.argv[2], int(sys.argv[3]), int(sys.argv[4]), sys.argv[5])
    elif sys.argv[1:2] == ["--time-steps"]:
        time_steps(sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
    else:
        main()
