"""``planopt compare``: several settings of one or more problems on the same seeds."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, overload

import typer

from planopt.commands.options import (
    PLANNERS,
    FirstSeedOption,
    JsonOption,
    OutOption,
    WorkersOption,
    option,
)
from planopt.commands.output import NO_PLAN, drawing, progress, results_folder, show
from planopt.errors import InputError, NoPlanError

if TYPE_CHECKING:
    from pathlib import Path

    from planopt.studies.comparison import Comparison

FINISHED_FOLDER = "finished_runs"
"""Folder in which finished runs are saved, so that an interrupted comparison can resume."""

Value = TypeVar("Value")


def compare(
    problems: Annotated[
        list[str], typer.Argument(metavar="PROBLEM...", help="Problem files, or names from `list`.")
    ],
    horizons: Annotated[str | None, option("--horizons", "N,N,...", "Horizons in steps.")] = None,
    planners: Annotated[str | None, option("--planners", "A,B", f"Any of {PLANNERS}.")] = None,
    costs_to_go: Annotated[
        str | None, option("--costs-to-go", "A,B", "geodesic, connected or both; task reach.")
    ] = None,
    sweep: Annotated[
        list[str] | None,
        option(
            "--sweep",
            "KEY=A,B",
            "Values of any key of the problem, such as constraints.p_min=0.5,0.8 or "
            "robots[*].speed_max_m_s=1,2; may be given several times.",
        ),
    ] = None,
    seeds: Annotated[
        str | None,
        option(
            "--seeds",
            "N|A:B",
            "Number of seeds, or seeds A to B - 1; default: the problem's comparison, or 30.",
        ),
    ] = None,
    first_seed: Annotated[int | None, FirstSeedOption] = None,
    workers: WorkersOption = 1,
    backend: Annotated[
        str, option("--backend", "NAME", "Where processes run: loky, dask or ray.")
    ] = "loky",
    parquet: Annotated[
        bool, option("--parquet", None, "Also save the runs as runs.parquet in --out.")
    ] = False,
    out: OutOption = None,
    json: JsonOption = False,
) -> int:
    """Compare settings over seeds. Exit codes: 0 all verified, 3 not all, 4 a run failed.

    Without settings, the comparison in the problem's own table compare is run.
    """
    from planopt.problems.load import load
    from planopt.problems.settings import DEFAULT_SEEDS
    from planopt.problems.tasks import task_of
    from planopt.report import comparison_text
    from planopt.studies.compare import Lists, default_seeds, own_settings, settings_of
    from planopt.studies.compare import compare as compared
    from planopt.studies.comparison import (
        COMPARISON,
        COMPARISON_FILE,
        comparison_json,
        no_comparison_json,
        require_pyarrow,
        save_no_comparison,
    )
    from planopt.studies.study import require_backend
    from planopt.tasks.task import NOT_VERIFIED

    require_backend(backend, "--backend")
    if parquet:
        require_pyarrow()
    loaded = [load(problem) for problem in problems]
    lists: dict[str, Any] = {
        "horizons": listed(horizons, "--horizons", int),
        "planners": listed(planners, "--planners", str),
        "costs_to_go": listed(costs_to_go, "--costs-to-go", str),
        "sweep": dict(swept(each) for each in sweep) if sweep else None,
    }
    own = own_settings(loaded, Lists(**lists))
    if len(loaded) == 1 and own is None and not any(lists.values()):
        raise InputError(
            f"there is nothing to compare: {loaded[0].name} has no [compare] table, and no "
            "setting was given",
            key="--horizons",
            remedy="give --horizons, --planners, --costs-to-go or --sweep",
        )
    chosen = (
        default_seeds(own, loaded)
        if seeds is None and first_seed is None
        else seed_range(str(DEFAULT_SEEDS) if seeds is None else seeds, first_seed)
    )
    # Invalid settings must be found before the first run.
    total = len(settings_of(loaded, Lists(**lists))) * len(chosen)
    figures = all(task_of(problem).has_figures(problem) for problem in loaded)
    with results_folder(out) as folder:
        try:
            with progress("driving, runs:", total) as advance:
                comparison = compared(
                    loaded,
                    **lists,
                    seeds=chosen,
                    workers=workers,
                    backend=backend,
                    on_run=lambda _: advance(),
                    finished=None if folder is None else folder / FINISHED_FOLDER,
                )
        except NoPlanError as error:
            data = no_comparison_json(loaded[0].name, str(error))
            if folder is not None:
                save_no_comparison(loaded[0], str(error), folder)
            show(json, data, f"{loaded[0].name}: no plan: {error}")
            return NO_PLAN
        if folder is not None:
            comparison.save(folder, parquet=parquet)
        where = f"for all numbers, use --out FOLDER, which writes {COMPARISON_FILE}"
        where = where if folder is None else f"all numbers:\n{folder / COMPARISON_FILE}"
        text = "" if json else f"{comparison_text(comparison)}\n{where}"
        unproven = sum(run.exit_code == NOT_VERIFIED for run in comparison.runs)
        if unproven:
            text += (
                f"\nexit code {comparison.exit_code}: {unproven} of {len(comparison.runs)} runs "
            )
            text += "have plans that are not verified (planopt simulate prints the reasons)"
        show(json, comparison_json(comparison) if json else {}, text)
        with drawing(folder, COMPARISON, wanted=figures) as new:
            if new is not None:
                _draw(comparison, new)
    return comparison.exit_code


def _draw(comparison: Comparison, folder: Path) -> None:
    """Plot the table, the traces over time, and the reliability diagram of connection."""
    from planopt.report import draw_comparison, draw_reliability, draw_traces, save_figure

    save_figure(draw_comparison(comparison), folder / "comparison.png")
    traces = draw_traces(comparison)
    if traces is not None:
        save_figure(traces, folder / "traces.png")
    if comparison.reliability:
        names = ", ".join(one.name for one in (comparison.problem, *comparison.others))
        title = f"{names}: connection over {len(comparison.runs)} runs"
        series = {"all settings": comparison.reliability}
        save_figure(draw_reliability(series, title), folder / "reliability.png")


def seed_range(text: str, first: int | None) -> range:
    """Return the seeds selected by ``--seeds`` and ``--first-seed``."""
    from planopt.problems.settings import seeds_of

    chosen = seeds_of(text, "--seeds")
    if first is None:
        return chosen
    if ":" in text:
        raise InputError(
            "cannot be combined with a range in --seeds",
            key="--first-seed",
            remedy="give either --seeds A:B, or --seeds N with --first-seed",
        )
    return range(first, first + len(chosen))


def swept(text: str) -> tuple[str, list[Any]]:
    """Return key and values of a sweep such as ``constraints.p_min=0.5,0.8``."""
    key, _, values = text.partition("=")
    try:
        found = tomllib.loads(f"values = [{values}]")["values"]
    except tomllib.TOMLDecodeError:
        found = [_word(part) for part in listed(values, "--sweep", str)]
    if not key.strip() or not found:
        raise InputError(
            f"cannot read {text!r}",
            key="--sweep",
            remedy="write KEY=VALUE,VALUE,..., such as constraints.p_min=0.5,0.8",
        )
    return key.strip(), [value for n, value in enumerate(found) if value not in found[:n]]


def _word(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


@overload
def listed(text: str, option: str, kind: Callable[[str], Value]) -> tuple[Value, ...]: ...
@overload
def listed(
    text: str | None, option: str, kind: Callable[[str], Value]
) -> tuple[Value, ...] | None: ...
def listed(text: str | None, option: str, kind: Callable[[str], Value]) -> tuple[Value, ...] | None:
    """Return the distinct values of a list such as ``1,2,5``; None for no list."""
    if text is None:
        return None
    values: list[Value] = []
    for part in (part.strip() for part in text.split(",")):
        try:
            values.append(kind(part))
        except ValueError:
            raise InputError(
                f"{part!r} in {text!r} is not a whole number",
                key=option,
                remedy="write for instance 1,5",
            ) from None
        if not part:
            raise InputError(
                f"{text!r} has an empty value", key=option, remedy="separate the values by commas"
            )
    return tuple(dict.fromkeys(values))
