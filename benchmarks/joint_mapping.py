"""Three robots that map one field, told what the others measure or not: paired over seeds.

``python benchmarks/joint_mapping.py --first-seed 100 --seeds 12 --log FILE`` drives three robots of
the library's problem ``outdoor_map`` from starts beside each other, once with
``planner.coordination = "joint"`` and once ``"decoupled"``, on the same channel. The measurements
of all robots are pooled at the end; the table has their information given the first ones, and the
error of the map that they make together, with 95 % intervals of the paired differences. The log is
a cache: runs that it has are not driven again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from planopt import Measurements, Problem, load
from planopt.channel import condition, true_power_dbm
from planopt.objectives.information import Information
from planopt.objectives.moments import posterior_moments
from planopt.planning.initial_data import prepare
from planopt.planning.solve import simulate
from planopt.planning.values.context import workspace_region
from planopt.studies.comparison import mean_interval

STARTS_M = ((8.0, 8.0), (8.0, 10.0), (10.0, 8.0))
FORMS = ("information", "average")


@dataclass(frozen=True)
class Record:
    """One run.

    Attributes
    ----------
    form, coordination, seed
        What was driven.
    information_nats
        Information on the channel of all robots' measurements together, given the first ones.
    variance_db2
        Mean variance of the channel over the workspace from all measurements.
    rms_db
        Error of the map from all measurements over the workspace.
    verified_share
        Of the plans.
    """

    form: str
    coordination: str
    seed: int
    information_nats: float
    variance_db2: float
    rms_db: float
    verified_share: float


def team_problem(form: str, coordination: str, steps: int) -> Problem:
    """Three robots beside each other; the information counts distinct places, so none is left."""
    problem = load("outdoor_map")
    first = problem.robots[0]
    robots = tuple(
        replace(first, name=f"rover_{k}", start_m=start) for k, start in enumerate(STARTS_M)
    )
    objective = replace(
        problem.objective,
        terms=(replace(problem.terms[0], form=form),),  # type: ignore[call-arg]
    )
    planner = replace(problem.planner, max_steps=steps, coordination=coordination)
    return replace(problem, robots=robots, objective=objective, planner=planner)


def drive(form: str, coordination: str, seed: int, steps: int) -> Record:
    """Drive one run, and pool what all robots measured."""
    problem = team_problem(form, coordination, steps)
    prepared = prepare(problem, seed)
    run = simulate(problem, seed=seed, prepared=prepared)
    prior = prepared.belief.posterior
    first = len(prior.measurements)
    new = [belief.posterior.measurements.take(slice(first, None)) for belief in run.beliefs]
    places = np.vstack([own.positions_m for own in new])
    power = np.concatenate([own.power_dbm for own in new])
    pooled = Measurements(
        np.vstack([prior.measurements.positions_m, places]),
        np.concatenate([prior.measurements.power_dbm, power]),
        np.concatenate([prior.measurements.censored, *(own.censored for own in new)]),
    )
    together = condition(prior.parameters, pooled)
    grid = workspace_region(problem).grid_m
    found = together.predict(grid)
    error = found.mean_db - true_power_dbm(prepared.truths[0], grid)
    verified = [plan.verdict.value == "verified" for made in run.plans for plan in made]
    return Record(
        form,
        coordination,
        seed,
        float(
            Information().value(
                posterior_moments(prior, _apart(places, problem.channel.measure_spacing_m))
            )
        ),
        float((found.deviation_db**2).mean() - prior.parameters.multipath_std_db**2),
        float(np.sqrt((error**2).mean())),
        float(np.mean(verified)),
    )


def _apart(places_m: np.ndarray, spacing_m: float) -> np.ndarray:
    """The places that are not nearer than the spacing to an earlier one: multipath counts once."""
    kept: list[int] = []
    for k, place in enumerate(places_m):
        if (np.linalg.norm(places_m[kept] - place, axis=1) >= spacing_m - 1e-5).all():
            kept.append(k)
    return places_m[kept]


def table(records: Sequence[Record]) -> str:
    """Means of both forms of coordination, and paired differences joint - decoupled."""
    lines = [
        "| term | measure | decoupled | joint | joint - decoupled, 95 % | seeds won |",
        "|---|---|---|---|---|---|",
    ]
    for form in FORMS:
        pairs = {
            how: {r.seed: r for r in records if r.form == form and r.coordination == how}
            for how in ("joint", "decoupled")
        }
        seeds = sorted(pairs["joint"].keys() & pairs["decoupled"].keys())
        if len(seeds) < 2:
            continue
        for name, sign, unit in (
            ("information_nats", 1.0, "nats"),
            ("variance_db2", -1.0, "dB^2"),
            ("rms_db", -1.0, "dB"),
        ):
            joint, alone = (
                np.array([getattr(pairs[how][seed], name) for seed in seeds])
                for how in ("joint", "decoupled")
            )
            low, high = mean_interval(joint - alone)
            interval = "" if low is None else f" [{low:+.3f}, {high:+.3f}]"
            won = int((sign * (joint - alone) > 0.0).sum())
            lines.append(
                f"| {form} | {name.rpartition('_')[0]} [{unit}] | {alone.mean():.3f} "
                f"| {joint.mean():.3f} | {(joint - alone).mean():+.3f}{interval} "
                f"| {won} of {len(seeds)} |"
            )
    return "\n".join(lines)


def main() -> None:
    """Drive what the log has not, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--steps", type=int, default=8)
    parser.add_argument("--forms", nargs="+", default=list(FORMS), choices=FORMS)
    parser.add_argument("--log", type=Path, required=True)
    given = parser.parse_args()
    records: list[Record] = []
    if given.log.exists():
        records = [Record(**json.loads(line)) for line in given.log.read_text().splitlines()]
    done = {(r.form, r.coordination, r.seed) for r in records}
    for seed in range(given.first_seed, given.first_seed + given.seeds):
        for form in given.forms:
            for how in ("joint", "decoupled"):
                if (form, how, seed) in done:
                    continue
                record = drive(form, how, seed, given.steps)
                with given.log.open("a") as log:
                    log.write(json.dumps(asdict(record)) + "\n")
                records.append(record)
    print(table(records))


if __name__ == "__main__":
    main()
