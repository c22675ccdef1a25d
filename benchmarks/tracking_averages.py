"""How well a station knows a target over whole runs: tr P averaged over time, seed by seed.

``python benchmarks/tracking_averages.py fig4 --settings additive:1 recourse:10:lattice``
drives every setting on the same seeds, prints a table with 95 % intervals, and compares each with
the first setting seed by seed. A setting is FORM:HORIZON, then PLANNER and PACKETS if they are not
the problem's: ``recourse:10:auto:estimates``. A target counts as lost where tr P was ever more than
three times that of the first estimate. ``--p-min 0.5`` adds a chance constraint. With ``--criterion
determinant`` plans and the table have det P. With ``--rows FILE`` rows are kept there, and a study
that was stopped goes on.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import process_time
from typing import cast, get_args

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from planopt import Problem, load, simulate
from planopt.objectives import TermsObjective, TrackingTerm
from planopt.objectives.terms.tracking import TrackingForm
from planopt.objectives.tracking import Criterion
from planopt.planning.loop.metrics import LOST_RATIO
from planopt.problems.settings import Packets
from planopt.studies.comparison import mean_interval


@dataclass(frozen=True)
class Row:
    """One run: its mean, last and largest tr P in m^2, the share of packets, and CPU seconds."""

    setting: str
    seed: int
    mean_m2: float
    mean_determinant_m4: float
    last_m2: float
    largest_m2: float
    delivered: float
    verified: float
    cpu_s: float


def with_setting(problem: Problem, setting: str, criterion: Criterion) -> Problem:
    """Return the problem with the form, horizon, planner and packets of FORM:HORIZON:..."""
    form, horizon, *rest = setting.split(":")
    planner = rest[0] if rest else problem.planner.name
    packets = rest[1] if len(rest) > 1 else problem.targets[0].packets
    terms = tuple(
        replace(term, form=cast("TrackingForm", form), criterion=criterion)
        if isinstance(term, TrackingTerm)
        else term
        for term in problem.objective.terms
    )
    return replace(
        problem,
        objective=TermsObjective(terms),
        planner=replace(problem.planner, horizon=int(horizon), name=planner),
        targets=(replace(problem.targets[0], packets=cast("Packets", packets)),),
    )


def run_row(problem: Problem, setting: str, seed: int, criterion: Criterion) -> Row:
    """Drive one run of a setting."""
    begun = process_time()
    run = simulate(with_setting(problem, setting, criterion), seed=seed)
    if run.target is None:
        raise AssertionError("the problem tracks a target")
    variance = run.target.station_variance_m2
    return Row(
        setting,
        seed,
        float(variance[1:].mean()),
        # The covariance is alike along both axes.
        float(np.square(0.5 * variance[1:]).mean()),
        float(variance[-1]),
        float(variance.max()),
        float(run.target.delivered.mean()),
        run.verified_rate,
        process_time() - begun,
    )


def table(problem: Problem, rows: Iterable[Row], criterion: Criterion) -> list[str]:
    """Return a line for each setting, the first being what others are compared with."""

    def mean_of(row: Row) -> float:
        return row.mean_determinant_m4 if criterion == "determinant" else row.mean_m2

    by_setting: dict[str, dict[int, Row]] = {}
    for row in rows:
        by_setting.setdefault(row.setting, {})[row.seed] = row
    first = next(iter(by_setting.values()))
    lost_m2 = LOST_RATIO * 2.0 * problem.targets[0].position_std_m ** 2
    lines = [
        "setting runs mean half_95 median last lost delivered verified cpu_s paired_difference "
        "half_95 ratio_of_means"
    ]
    for setting, found in by_setting.items():
        means = np.array([mean_of(row) for row in found.values()])
        both = sorted(found.keys() & first.keys())
        own, other = (np.array([mean_of(each[seed]) for seed in both]) for each in (found, first))
        each = list(found.values())
        lost = sum(row.largest_m2 > lost_m2 for row in each)
        lines.append(
            f"{setting} {len(means)} {means.mean():.4f} {_half(means):.4f} {np.median(means):.4f} "
            f"{np.mean([row.last_m2 for row in each]):.3f} {lost} "
            f"{np.mean([row.delivered for row in each]):.3f} "
            f"{min(row.verified for row in each):.3f} {np.median([r.cpu_s for r in each]):.1f} "
            f"{(own - other).mean():+.4f} {_half(own - other):.4f} {own.mean() / other.mean():.3f}"
        )
    return lines


def _half(values: NDArray[np.float64]) -> float:
    """Half of the 95 % interval of a mean; NaN for too few values."""
    least, largest = mean_interval(values)
    return float("nan") if least is None or largest is None else 0.5 * (largest - least)


def main() -> None:
    """Drive what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problem")
    parser.add_argument("--settings", nargs="+", default=["additive:1", "additive:10"])
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--p-min", type=float)
    parser.add_argument("--criterion", choices=get_args(Criterion), default="trace")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--rows", type=Path)
    chosen = parser.parse_args()
    problem = load(chosen.problem)
    if chosen.p_min is not None:
        bound = replace(problem.constraints, p_min=chosen.p_min)
        problem = replace(problem, constraints=bound)
    rows: list[Row] = []
    if chosen.rows is not None and chosen.rows.exists():
        rows = [Row(**json.loads(line)) for line in chosen.rows.read_text().splitlines()]
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    asked = [(setting, seed) for setting in chosen.settings for seed in seeds]
    done = {(row.setting, row.seed) for row in rows}
    made = Parallel(n_jobs=chosen.workers, return_as="generator")(
        delayed(run_row)(problem, *each, chosen.criterion) for each in asked if each not in done
    )
    for row in made:
        rows.append(row)
        if chosen.rows is not None:
            with chosen.rows.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(row)) + "\n")
    found = {(row.setting, row.seed): row for row in rows}
    print("\n".join(table(problem, [found[each] for each in asked], chosen.criterion)))


if __name__ == "__main__":
    main()
