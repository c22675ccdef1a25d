"""``planopt compare``: the same seeds under several horizons, planners and costs to go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from planopt.commands.options import (
    PLANNERS,
    CalibrationOption,
    JsonOption,
    OutOption,
    ProblemArgument,
)
from planopt.commands.output import NO_PLAN, drawing, progress, results_folder, show
from planopt.errors import InputError, NoPlanError
from planopt.files.result_folder import ResultFiles, replaced_results

if TYPE_CHECKING:
    from planopt.problems.problem import Problem
    from planopt.studies.comparison import Comparison

COMPARISON_FILE = "comparison.json"
FINISHED_FOLDER = "finished_runs"
"""Where finished runs are kept, so that a comparison that was stopped goes on."""

COMPARISON = ResultFiles("comparison", (COMPARISON_FILE, "comparison.png", "reliability.png"))
"""The files of a comparison with its pictures."""

Value = TypeVar("Value")


def compare(
    problem: ProblemArgument,
    horizons: Annotated[str, typer.Option("--horizons", metavar="N,N,...", help="Steps ahead.")],
    planners: Annotated[
        str | None,
        typer.Option(
            "--planners",
            metavar="A,B",
            help=f"Any of {PLANNERS}.",
        ),
    ] = None,
    costs_to_go: Annotated[
        str | None,
        typer.Option(
            "--costs-to-go",
            metavar="A,B",
            help="geodesic, connected (both); task reach.",
        ),
    ] = None,
    calibration: CalibrationOption = None,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Number of random seeds.")] = 30,
    first_seed: Annotated[int, typer.Option("--first-seed", min=0, help="First random seed.")] = 0,
    workers: Annotated[int, typer.Option("--workers", min=1, help="Number of processes.")] = 1,
    backend: Annotated[
        str, typer.Option("--backend", metavar="NAME", help="Where processes run: loky.")
    ] = "loky",
    out: OutOption = None,
    json: JsonOption = False,
) -> int:
    """Compare settings over seeds. Exit code 0 all verified, 3 not all, 4 a run not ended."""
    from planopt.planning.files.saved import write_record
    from planopt.problems.overrides import with_overrides
    from planopt.problems.systems import Request, SystemProblem, load_any
    from planopt.report.tables import comparison_text
    from planopt.studies.compare import compare_horizons, default_costs_to_go
    from planopt.studies.study import BACKENDS

    if backend not in BACKENDS:
        raise InputError(
            f"{backend!r} is not there", key="--backend", remedy=f"use {', '.join(BACKENDS)}"
        )
    asked = load_any(problem)
    steps = listed(horizons, "--horizons", int)
    if isinstance(asked, SystemProblem):
        from planopt.commands.systems import answer_command

        return answer_command(
            asked,
            "compare",
            Request(
                first_seed,
                steps,
                () if planners is None else listed(planners, "--planners", str),
                range(first_seed, first_seed + seeds),
            ),
            out=out,
            json=json,
            replaced=COMPARISON,
            file=COMPARISON_FILE,
            not_for_it={
                "--costs-to-go": costs_to_go,
                "--calibration": calibration,
                "--workers": None if workers == 1 else str(workers),
            },
        )
    if calibration is not None:
        asked = with_overrides(asked, calibration=calibration)
    names = (asked.planner.name,) if planners is None else listed(planners, "--planners", str)
    ways = None if costs_to_go is None else listed(costs_to_go, "--costs-to-go", str)
    # Settings that are not allowed are found before the first run.
    for n in steps:
        with_overrides(asked, horizon=n)
    for name in names:
        with_overrides(asked, planner=name)
    for way in ways or ():
        with_overrides(asked, cost_to_go=way)
    figures = asked.report.figures
    with results_folder(out) as folder:
        try:
            costs = default_costs_to_go(asked) if ways is None else ways
            total = len(steps) * len(names) * len(costs) * seeds
            with progress("driving, runs:", total) as advance:
                comparison = compare_horizons(
                    asked,
                    steps,
                    planners=names,
                    costs_to_go=ways,
                    seeds=range(first_seed, first_seed + seeds),
                    workers=workers,
                    backend=backend,
                    on_run=lambda _: advance(),
                    finished=None if folder is None else folder / FINISHED_FOLDER,
                )
        except NoPlanError as error:
            data = comparison_json(asked, None, str(error))
            if folder is not None:
                with replaced_results(folder, COMPARISON) as new:
                    write_record(data, asked, new / COMPARISON_FILE)
            show(json, data, f"{asked.name}: no plan: {error}")
            return NO_PLAN
        data = comparison_json(asked, comparison, "")
        if folder is not None:
            with replaced_results(folder, COMPARISON, pictures_follow=figures) as new:
                write_record(data, asked, new / COMPARISON_FILE)
        text = "" if json else comparison_text(comparison)
        show(json, data, text)
        with drawing(folder, COMPARISON, wanted=figures) as new:
            if new is not None:
                from planopt.commands.pictures import picture_comparison

                picture_comparison(comparison, new)
    return exit_code(comparison)


def exit_code(comparison: Comparison) -> int:
    """0 all arrived and every released step verified, 3 some not verified, 4 some not arrived."""
    from planopt.planning.run import ARRIVED

    if any(run.outcome not in ARRIVED for run in comparison.runs):
        return NO_PLAN
    return 0 if all(run.verified_rate == 1.0 for run in comparison.runs) else 3


def comparison_json(
    problem: Problem, comparison: Comparison | None, message: str
) -> dict[str, Any]:
    """The JSON keys of ``compare``; no rows if there provably is no plan."""
    from planopt.planning.files.record import finite
    from planopt.planning.files.run_json import reliability_json, summary_json
    from planopt.studies.comparison import runs_by_setting, runs_reliability

    if comparison is None:
        return {
            "problem": problem.name,
            "outcome": "no_plan",
            "rows": [],
            "reliability": {"all": [], "settings": []},
            "runs": [],
            "wall_s": None,
            "resumed": 0,
            "message": message,
        }
    rows = [
        {name: finite(v) if isinstance(v, float) else v for name, v in asdict(row).items()}
        for row in comparison.rows
    ]
    return {
        "problem": problem.name,
        "outcome": "compared",
        "rows": rows,
        "reliability": {
            "all": reliability_json(comparison.reliability),
            "settings": [
                {
                    "horizon": runs[0].horizon,
                    "planner": runs[0].planner,
                    "cost_to_go": runs[0].cost_to_go,
                    "bins": reliability_json(runs_reliability(runs)),
                }
                for runs in runs_by_setting(comparison.runs)
            ],
        },
        "runs": [summary_json(run) for run in comparison.runs],
        "wall_s": finite(comparison.wall_s),
        "resumed": comparison.resumed,
        "message": message,
    }


def listed(text: str, option: str, kind: Callable[[str], Value]) -> tuple[Value, ...]:
    """The values of a list such as ``1,2,5``, each once.

    Raises
    ------
    InputError
        A value is missing or not of its kind.
    """
    parts = [part.strip() for part in text.split(",")]
    try:
        values = [kind(part) for part in parts]
    except ValueError:
        values = []
    if not values or "" in parts:
        raise InputError(f"cannot read {text!r}", key=option, remedy="separate values by commas")
    return tuple(dict.fromkeys(values))
