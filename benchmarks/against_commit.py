"""Closed loops of an earlier commit and of today's code on the same seeds, step beside step.

``git worktree add --detach OLD 52f8475``, ``python benchmarks/against_commit.py --old OLD``.
Both load the earlier commit's problem files and draw the same ground truth. Their steps take turns,
so that the ratio of their processor times holds on a busy machine too.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

TIMED_STEPS = 40
"""Steps after the first, which fills the map, whose times are compared."""

PROBLEMS = ("harbour_reach", "munich_courier", "munich_hard", "open_field", "two_station_courier")


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


def drive_both(old: Path, file: Path, seed: int, horizon: int, charge: str) -> list[dict[str, Any]]:
    """Drive both codes in turn; the earlier one's run first, each with the times of its steps."""
    here = Path(__file__).resolve()
    with ExitStack() as both:
        runs: list[subprocess.Popen[str]] = []
        for tree, charged in ((old, ""), (here.parents[1], charge)):
            asked = [str(file), str(seed), str(horizon), charged]
            alone = {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
            run = subprocess.Popen(
                [sys.executable, str(here), "--drive", *asked],
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
    from planopt.planning.loop.clairvoyant import realised_cost_m
    from planopt.planning.prepare import prepare

    problem, track = load(file), np.array(track_m)
    length = float(np.linalg.norm(np.diff(track, axis=0), axis=1).sum())
    cost = realised_cost_m(problem, prepare(problem, seed).truths, track)
    return length, (cost - length) / problem.reach.outage_price


def main() -> None:
    """Drive and print a row for each problem."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--old", type=Path, required=True, help="work tree of the earlier commit")
    parser.add_argument("--problems", nargs="+", default=PROBLEMS)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--horizon", type=int, default=0, help="0 for each problem's own")
    parser.add_argument("--charge", default="", help="outage_charge of today's code")
    asked = parser.parse_args()
    old = asked.old.resolve()
    print("| problem | arrived | length [m] | out of contact [m] | below p_min [%] | step ratio |")
    print("|---|---|---|---|---|---|")
    for name in asked.problems:
        file, rows, ratios = old / "problems" / f"{name}.toml", [], []
        for seed in range(asked.first_seed, asked.first_seed + asked.seeds):
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
    else:
        main()
