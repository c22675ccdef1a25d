"""``planopt bench run|report|check``: regression suite of the solvers."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from planopt.commands.compare import listed
from planopt.commands.options import FirstSeedOption, JsonOption, WorkersOption, option
from planopt.commands.output import progress, results_folder, show
from planopt.errors import InputError
from planopt.files.writing import replaced_results

if TYPE_CHECKING:
    from planopt.studies.bench_cases import Manifest, Row
    from planopt.studies.bench_references import References

REPORT_FILE, MARKDOWN_FILE, PAGE_FILE = "report.json", "report.md", "report.html"

REPORT = (REPORT_FILE, MARKDOWN_FILE, PAGE_FILE)
"""Files of a report, including the page."""
SHOWN = 20
"""Maximum number of cases of each kind that are printed; the JSON file lists all."""

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
    out: Annotated[Path, option("--out", "DIR", "Folder of the rows.")],
    problems: ProblemsOption = None,
    planners: Annotated[
        str | None, option("--planners", "A,B", "Names; else all that a problem allows.")
    ] = None,
    horizons: Annotated[
        str | None, option("--horizons", "N,N", "Horizons; default: the problem's, 5 and 20.")
    ] = None,
    seeds: Annotated[int, option("--seeds", None, "How many, for plans.", min=0)] = 3,
    run_seeds: Annotated[int, option("--run-seeds", None, "For closed loops.", min=0)] = 1,
    prove: Annotated[
        float, option("--prove", "SECONDS", "For a proven bound of each plan.", min=0)
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
            f"has changed references ({len(changed)}): " + "; ".join(changes),
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
