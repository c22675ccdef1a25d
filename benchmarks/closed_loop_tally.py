"""What became of one random closed loop: driven, saved, judged from disk, counted."""

from __future__ import annotations

import re
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from closed_loop_scenes import MAX_STEPS, random_problem

from planopt import InputError, NoPlanError, Plan, Problem, Verdict, check
from planopt.extend import Rung
from planopt.planning.solve import simulate

OBJECTION = re.compile(r"^run\.json, key (plans.*), the plan for step \d+: (.*)$", re.DOTALL)
NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?")


@dataclass
class Tally:
    """Counts of one run, or of several.

    Attributes
    ----------
    seed, task, planner, horizon
        Of one run.
    steps
        Released plans, of every robot.
    verdicts, rungs, outcomes
        How many of each.
    unverified
        Objections to plans that were released as `violated`, numbers left out.
    rejected
        Reasons for which the checker rejects anything else: there should be none.
    faults
        Exceptions and warnings: there should be none.
    slowest_s, wall_s
        CPU time a robot of the longest step but the first, and time of the whole run with check.
    """

    seed: int = -1
    task: str = ""
    planner: str = ""
    horizon: int = 0
    steps: int = 0
    verdicts: Counter[str] = field(default_factory=Counter)
    rungs: Counter[str] = field(default_factory=Counter)
    outcomes: Counter[str] = field(default_factory=Counter)
    unverified: Counter[str] = field(default_factory=Counter)
    rejected: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    slowest_s: float = 0.0
    wall_s: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return dict(vars(self))


def drive(seed: int, folder: Path, max_steps: int = MAX_STEPS) -> Tally:
    """Drive the problem of a seed, save the run into `folder`, and judge it from there."""
    begun = perf_counter()
    problem = random_problem(seed, max_steps)
    planner = problem.planner
    tally = Tally(seed, problem.task, planner.name, planner.horizon)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            _drive(problem, seed, folder, tally)
        except (NoPlanError, InputError) as answer:
            tally.outcomes[f"{type(answer).__name__}: {_without_numbers(str(answer))}"] += 1
        except Exception:
            tally.faults.append(traceback.format_exc(limit=-4))
    tally.wall_s = perf_counter() - begun
    return tally


def _drive(problem: Problem, seed: int, folder: Path, tally: Tally) -> None:
    clock = [process_time()]
    folder.mkdir(parents=True, exist_ok=True)
    run = simulate(problem, seed=seed, on_step=lambda _: clock.append(process_time()))
    # The first step has the setting up in it.
    tally.slowest_s = max(np.diff(clock)[1:], default=0.0) / len(problem.robots)
    run.save(folder)
    said: dict[str, Plan] = {}
    for number, (made, log) in enumerate(zip(run.plans, run.runs, strict=True)):
        said |= {f"plans[{number}].released[{step}]": plan for step, plan in enumerate(made)}
        tally.outcomes[log.outcome.value] += 1
        tally.steps += len(made)
        tally.verdicts.update(plan.verdict.value for plan in made)
        tally.rungs.update(plan.rung.value for plan in made)
        tally.faults += [text for plan in made if (text := _unlogged(problem, plan))]
    for reason in check(folder).reasons:
        objection = OBJECTION.match(reason)
        if objection and said[objection[1]].verdict is Verdict.VIOLATED:
            tally.unverified[_without_numbers(objection[2])] += 1
        else:
            tally.rejected.append(reason)


def _unlogged(problem: Problem, plan: Plan) -> str | None:
    """What a released plan does not say of itself, or what is no number."""
    numbers = [plan.objective, plan.lattice_objective, *plan.positions_m.ravel()]
    if not np.isfinite(numbers).all():
        return f"{plan.rung.value}: a number that is none"
    if plan.verdict is not Verdict.VERIFIED and not plan.certificate.reasons:
        return f"{plan.rung.value}: {plan.verdict.value} for no reason"
    lengths = np.linalg.norm(np.diff(plan.positions_m, axis=0), axis=1)
    if plan.rung is Rung.STOP and plan.drive is None and lengths.max() > 0.0:
        return "a stop that moves"
    if plan.certificate.min_clearance_m < problem.constraints.clearance_m - 1e-6:
        return f"{plan.rung.value}: nearer than the clearance"
    return None


def _without_numbers(text: str) -> str:
    return NUMBER.sub("#", text)


def summed(tallies: list[Tally]) -> Tally:
    """All runs as one."""
    total = Tally()
    for tally in tallies:
        total.steps += tally.steps
        for name in ("verdicts", "rungs", "outcomes", "unverified"):
            getattr(total, name).update(getattr(tally, name))
        total.rejected += [f"seed {tally.seed}: {reason}" for reason in tally.rejected]
        total.faults += [f"seed {tally.seed}: {fault}" for fault in tally.faults]
        total.slowest_s = max(total.slowest_s, tally.slowest_s)
        total.wall_s += tally.wall_s
    return total
