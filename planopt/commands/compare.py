"""Commands that run many problems: ``planopt compare`` and ``planopt bench run|report|check``."""

from __future__ import annotations

import contextlib
import tomllib
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from planopt.commands.options import (
    NO_PLAN,
    PLANNERS,
    FirstSeedOption,
    JsonOption,
    OutOption,
    WorkersOption,
    drawing,
    option,
    progress,
    results_folder,
    show,
)
from planopt.errors import InputError, NoPlanError
from planopt.files.writing import replaced_results

if TYPE_CHECKING:
    from pathlib import Path

    from planopt.studies.bench_cases import Manifest, Row
    from planopt.studies.bench_references import References

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
                from planopt.report import (
                    draw_comparison,
                    draw_reliability,
                    draw_traces,
                    save_figure,
                )

                save_figure(draw_comparison(comparison), new / "comparison.png")
                traces = draw_traces(comparison)
                if traces is not None:
                    save_figure(traces, new / "traces.png")
                if comparison.reliability:
                    names = ", ".join(one.name for one in (comparison.problem, *comparison.others))
                    title = f"{names}: connection over {len(comparison.runs)} runs"
                    series = {"all settings": comparison.reliability}
                    save_figure(draw_reliability(series, title), new / "reliability.png")
    return comparison.exit_code


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
        found = list[Any](listed(values, "--sweep", str) or ())
        for number, part in enumerate(found):
            with contextlib.suppress(tomllib.TOMLDecodeError):
                found[number] = tomllib.loads(f"value = {part}")["value"]
    if not key.strip() or not found:
        raise InputError(
            f"cannot read {text!r}",
            key="--sweep",
            remedy="write KEY=VALUE,VALUE,..., such as constraints.p_min=0.5,0.8",
        )
    return key.strip(), [value for n, value in enumerate(found) if value not in found[:n]]


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


REPORT_FILE, MARKDOWN_FILE, PAGE_FILE = "report.json", "report.md", "report.html"

REPORT = (REPORT_FILE, MARKDOWN_FILE, PAGE_FILE)  # Files of a report, including the page
SHOWN = 20  # Maximum number of cases of each kind that are printed; the JSON file lists all

REGRESSED, NOT_ANSWERED = 1, 3

bench = typer.Typer(
    help="Solve the library again and compare with its references.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)

ReferencesOption = Annotated[
    Path | None, option("--references", "FILE", "References in place of those of the library.")
]
ProblemsOption = Annotated[
    str | None, option("--problems", "A,B", "Names or files; else the whole library.")
]


@bench.command("run")
def run(
    out: Annotated[Path, option("--out", "DIR", "Folder for the results.")],
    problems: ProblemsOption = None,
    planners: Annotated[
        str | None, option("--planners", "A,B", "Names; else all that a problem allows.")
    ] = None,
    horizons: Annotated[
        str | None, option("--horizons", "N,N", "Horizons; default: the problem's, 5 and 20.")
    ] = None,
    seeds: Annotated[int, option("--seeds", "N", "Number of seeds for plans.", min=0)] = 3,
    run_seeds: Annotated[int, option("--run-seeds", "N", "Number of seeds for runs.", min=0)] = 1,
    prove: Annotated[
        float, option("--prove", "SECONDS", "Time to prove a bound on each plan.", min=0)
    ] = 0.0,
    first_seed: Annotated[int, FirstSeedOption] = 0,
    workers: WorkersOption = 1,
    json: JsonOption = False,
) -> int:
    """Solve all cases that have no result yet. Exit codes: 0, or 3 if a check rejects a result."""
    from planopt.studies.bench_cases import ERROR, TABLE, library_cases, run_into

    cases = library_cases(
        listed(problems, "--problems", str),
        planners=listed(planners, "--planners", str),
        horizons=listed(horizons, "--horizons", int),
        seeds=range(first_seed, first_seed + seeds),
        run_seeds=range(first_seed, first_seed + run_seeds),
        prove_s=prove,
    )
    with results_folder(out) as folder:
        if folder is None:
            raise AssertionError("--out is required")
        with progress("solving, cases:", len(cases)) as advance:
            rows = run_into(folder, cases, workers=workers, on_row=lambda _: advance())
    failed = [row for row in rows if row.accepted is False or row.outcome == ERROR]
    words = [f"{row.case}: {'; '.join(row.reasons)}" for row in failed]
    data = {"rows": len(rows), "table": str(out / TABLE), "failed": words}
    lines = [
        f"{len(rows)} cases finished; {len(failed)} failed (error, or rejected by the check)",
        *(f"  {each}" for each in words),
        f"next: planopt bench report {out}",
    ]
    show(json, data, "\n".join(lines))
    return NOT_ANSWERED if failed else 0


@bench.command("report")
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a run.")],
    references: ReferencesOption = None,
    freeze: Annotated[
        Path | None, option("--freeze", "FILE", "Add the rows to this file of references.")
    ] = None,
    replace: Annotated[
        bool, option("--replace", None, "With --freeze: also where references change.")
    ] = False,
    page: Annotated[bool, option("--page/--no-page", None, "Write report.html.")] = True,
    json: JsonOption = False,
) -> int:
    """Print the scores of the planners; write them as Markdown and HTML. Exit code 0."""
    from planopt.files.writing import strict_text, write_text
    from planopt.report import bench_page, page_markdown
    from planopt.report.page import page_html
    from planopt.studies.bench_cases import read_manifest, read_rows
    from planopt.studies.bench_references import read_references, references_file

    manifest, rows = read_manifest(folder), read_rows(folder)
    if not rows:
        raise InputError(
            "has no results yet", file=folder, remedy="run planopt bench run --out DIR first"
        )
    if freeze is not None:
        return _freeze(rows, manifest, freeze, replace, json)
    has_references = references is not None or references_file().exists()
    known = read_references(references) if has_references else {}
    data, content = report_json(manifest, rows, known), bench_page(rows, known, manifest)
    with replaced_results(folder, REPORT) as new:
        write_text(new / REPORT_FILE, strict_text(data))
        write_text(new / MARKDOWN_FILE, page_markdown(content))
        if page:
            write_text(new / PAGE_FILE, page_html(content))
    found = [
        f"{kind}: {words}"
        for key, kind in (
            ("regressions", "worse"),
            ("improvements", "better"),
            ("rejected", "rejected"),
        )
        for words in data[key][:SHOWN]
    ]
    show(json, data, "\n".join([page_markdown(content, whole=False), *found]))
    return 0


@bench.command("check")
def check(
    references: ReferencesOption = None,
    problems: ProblemsOption = None,
    workers: WorkersOption = 2,
    json: JsonOption = False,
) -> int:
    """Solve the fast subset again. Exit codes: 0, or 1 if a case is worse than its reference."""
    from time import perf_counter

    from planopt.studies.bench_cases import answers
    from planopt.studies.bench_references import assessed, fast_cases, read_references

    begun = perf_counter()
    known = read_references(references)
    cases, worse = fast_cases(known, listed(problems, "--problems", str))
    with progress("solving, cases:", len(cases)) as advance:
        rows = answers(cases, workers=workers, on_row=lambda _: advance())
    regressed, better = assessed(rows, known, lambda row: f"{row.case}: no reference")
    worse += regressed
    wall_s = perf_counter() - begun
    data = {
        "cases": len(rows),
        "regressions": worse,
        "improvements": better,
        "wall_s": wall_s,
        "rows": [asdict(row) for row in rows],
    }
    lines = [
        *(f"worse: {words}" for words in worse),
        *(f"better: {words}" for words in better),
        f"{len(rows)} cases in {wall_s:.0f} s: "
        + (f"{len(worse)} worse than their references" if worse else "as good as the references"),
    ]
    show(json, data, "\n".join(lines))
    return REGRESSED if worse else 0


def report_json(manifest: Manifest, rows: list[Row], known: References) -> dict[str, Any]:
    """Return the JSON object of ``bench report``."""
    from planopt.studies.bench_references import (
        LIMIT_S,
        SHIFT_S,
        assessed,
        best_known,
        scores,
        time_profile,
    )

    best = best_known(known, rows)
    worse, better = assessed(rows, known, lambda row: "")
    kinds = dict.fromkeys(row.kind for row in rows)
    by_kind = {kind: [row for row in rows if row.kind == kind] for kind in kinds}
    profiles = {kind: time_profile(own, best) for kind, own in by_kind.items()}
    return {
        **asdict(manifest),
        "rows": len(rows),
        "questions": len({row.question for row in rows}),
        "with_reference": sum(row.case in known for row in rows),
        "scores": {
            kind: [asdict(score) for score in scores(own, best)] for kind, own in by_kind.items()
        },
        "time_shift_s": SHIFT_S,
        "time_limit_s": LIMIT_S,
        "profiles": {
            kind: {
                "ratios": profile.ratios.tolist(),
                "shares": dict(zip(profile.planners, profile.shares.tolist(), strict=True)),
            }
            for kind, profile in profiles.items()
        },
        "regressions": worse,
        "improvements": better,
        "rejected": [
            f"{row.case}: {'; '.join(row.reasons)}" for row in rows if row.accepted is False
        ],
    }


def _freeze(rows: list[Row], manifest: Manifest, file: Path, replace: bool, json: bool) -> int:
    """Add rows to a file of references; existing references change only if `replace` is set."""
    from planopt.studies.bench_references import frozen, read_references, write_references

    known = read_references(file) if file.exists() else {}
    references, changes = frozen(known, rows, manifest.made_by)
    changed = [case for case in known if references[case] != known[case]]
    if changed and not replace:
        raise InputError(
            f"has {len(changed)} references that differ from new results: " + "; ".join(changes),
            file=file,
            remedy="add --replace to overwrite them, and explain each change in the commit message",
        )
    write_references(references, file)
    data = {
        "references": len(references),
        "added": len(references) - len(known),
        "changes": changes,
    }
    lines = [
        *changes,
        f"{file}: {len(references)} references, {data['added']} new, {len(changed)} changed",
    ]
    show(json, data, "\n".join(lines))
    return 0
