"""References of the regression suite: the best known result of each planner for every case.

Each change of references is a separate commit that lists every number and the reason.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from planopt.errors import InputError
from planopt.files.reading import read_text
from planopt.files.typed_json import decoded, encoded
from planopt.files.writing import write_text
from planopt.planning.plan import Verdict
from planopt.problems.library import library_folder
from planopt.problems.load import load
from planopt.problems.tasks import task_of
from planopt.studies.bench.cases import PLAN, RUN, Answer, Case, Question, Row, library_names

OBJECTIVE_SHARE = 0.01
"""Relative difference above which one objective counts as worse than another."""

DIGITS = 9
"""Significant digits of stored objectives."""

FAST_SEED = 0
"""Seed of the fast subset."""

FAST_PLANNERS = ("auto", "scp", "lattice")
"""Planners of the fast subset."""

FAST_CPU_S = 3.0
"""Maximum CPU time in seconds of other cases of the fast subset when they were stored."""

_ABOUT = (
    "Best known results of the solver regression suite, one a line: planopt bench report DIR "
    "--freeze FILE. They change in commits of their own that list each number and why."
)


@dataclass(frozen=True, kw_only=True)
class Reference(Answer):
    """Best known result of a planner for a case."""

    made_by: str  # Program that produced it


References = Mapping[Case, Reference]


def references_file() -> Path:
    """Return the path of the library's references."""
    return library_folder() / "references.json"


def read_references(file: Path | None = None) -> dict[Case, Reference]:
    """Read references from a file, by default the library's."""
    path = references_file() if file is None else file
    try:
        listed = json.loads(read_text(path))["references"]
        found = decoded(list[Reference], listed)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(
            f"is no file of references: {error}",
            file=path,
            remedy="take it from the repository again",
        ) from None
    if not all(math.isfinite(one.objective or 0.0) and one.cpu_s >= 0.0 for one in found):
        raise InputError("has a number that cannot be", file=path, remedy="run the suite again")
    references = {one.case: one for one in found}
    if len(references) < len(found):
        raise InputError("has a case twice", file=path, remedy="take out one of them")
    return references


def write_references(references: References, file: Path) -> None:
    """Write references atomically, sorted by case, one per line."""
    lines = [
        json.dumps(encoded(references[case]), allow_nan=False, ensure_ascii=False)
        for case in sorted(references)
    ]
    listed = ",\n".join(lines)
    write_text(file, f'{{"about": {json.dumps(_ABOUT)},\n"references": [\n{listed}\n]}}\n')


def reference_of(row: Row, made_by: str) -> Reference:
    """Return a row as a reference."""
    names = [part.name for part in fields(Reference) if part.name != "made_by"]
    kept: dict[str, Any] = {name: getattr(row, name) for name in names}
    if row.objective is not None:
        kept["objective"] = float(f"{row.objective:.{DIGITS}g}")
    kept["cpu_s"] = round(row.cpu_s, 2)
    return Reference(**kept, made_by=made_by)


def frozen(
    known: References, rows: Iterable[Row], made_by: str
) -> tuple[dict[Case, Reference], list[str]]:
    """Return references updated by rows, and a list of the changes; failed rows are skipped."""
    references = dict(known)
    changes: list[str] = []
    for row in rows:
        if row.accepted is False or row.outcome == "error":
            changes.append(f"{row.case}: left out, {'; '.join(row.reasons)}")
            continue
        new, old = reference_of(row, made_by), references.get(row.case)
        if old is not None:
            changed = [
                f"{name} {getattr(old, name)} -> {getattr(new, name)}"
                for name in ("objective", "verdict", "outcome", "rungs")
                if getattr(old, name) != getattr(new, name)
            ]
            if not changed:
                continue
            changes.append(f"{row.case}: {', '.join(changed)}")
        references[row.case] = new
    return references, changes


def worse_share(objective: float, best: float, sense: str) -> float:
    """Return the relative amount by which an objective is worse than `best`; negative if better."""
    worse = objective - best if sense == "min" else best - objective
    return worse / max(abs(best), 1e-12)


def best_known(references: References, rows: Iterable[Row] = ()) -> dict[Question, float]:
    """Return the best objective of each question among verified answers not rejected by a check."""
    best: dict[Question, float] = {}
    accepted = [one for one in rows if one.accepted is not False]
    for one in (*references.values(), *accepted):
        if one.objective is None or one.verdict != Verdict.VERIFIED.value:
            continue
        question = one.case.question
        known = best.get(question)
        if known is None or worse_share(one.objective, known, one.sense) < 0.0:
            best[question] = one.objective
    return best


def regressions(row: Row, reference: Reference) -> list[str]:
    """Return the respects in which a row is worse than its reference, as text."""
    found: list[str] = []
    order = [verdict.value for verdict in Verdict]
    if row.outcome != reference.outcome:
        found.append(f"outcome {row.outcome}, was {reference.outcome}")
    if row.verdict not in order or order.index(row.verdict) > order.index(reference.verdict):
        found.append(f"verdict {row.verdict}, was {reference.verdict}")
    if row.accepted is False:
        found.append("the check from its files rejects it")
    if reference.objective is not None:
        if row.objective is None:
            found.append(f"no objective, was {reference.objective:.6g}")
        elif (share := worse_share(row.objective, reference.objective, row.sense)) > (
            OBJECTIVE_SHARE
        ):
            found.append(
                f"objective {row.objective:.6g}, was {reference.objective:.6g}: {share:.1%} worse"
            )
    if found and row.reasons:
        found[0] += f" ({'; '.join(row.reasons[:3])})"
    return [f"{row.case}: {words}" for words in found]


def improvement(row: Row, reference: Reference) -> str | None:
    """Return the improvement of a row over its reference as text; None if it is not significant."""
    if row.objective is None or reference.objective is None or row.accepted is False:
        return None
    share = -worse_share(row.objective, reference.objective, row.sense)
    if share <= OBJECTIVE_SHARE:
        return None
    return (
        f"{row.case}: objective {row.objective:.6g}, was {reference.objective:.6g}: "
        f"{share:.1%} better"
    )


def fast_cases(
    references: References, problems: Sequence[str] | None = None
) -> tuple[list[Case], list[str]]:
    """Return the cases of the fast subset, and a list of missing references.

    The subset covers plans of `FAST_PLANNERS`, and quick runs, designs and deployments, without
    changes of the problems.
    """
    cases: list[Case] = []
    missing: list[str] = []
    names = library_names() if problems is None else problems
    for name in names:
        problem = load(name)
        horizon, _, cost_to_go = task_of(problem).labels(problem)
        mine = [
            one
            for one in references.values()
            if one.problem == name
            and one.seed == FAST_SEED
            and (one.horizon, one.cost_to_go) == (horizon, cost_to_go or "")
        ]
        if not mine:
            missing.append(f"{name}: no reference with its own settings, seed {FAST_SEED}")
        cases += sorted(
            one.case
            for one in mine
            if (one.planner in FAST_PLANNERS and one.kind == PLAN)
            or (one.cpu_s <= FAST_CPU_S and (one.kind == RUN or one.planner == problem.task))
        )
    missing += [
        f"{name}: has references, but the library has no such problem"
        for name in sorted({one.problem for one in references.values()}.difference(library_names()))
        if problems is None
    ]
    return cases, missing


def assessed(
    rows: Sequence[Row], references: References, on_unknown: Callable[[Row], str]
) -> tuple[list[str], list[str]]:
    """Return all regressions and all improvements of rows, as text."""
    worse: list[str] = []
    better: list[str] = []
    for row in rows:
        reference = references.get(row.case)
        if reference is None:
            worse += [words for words in (on_unknown(row),) if words]
            continue
        worse += regressions(row, reference)
        better += [words for words in (improvement(row, reference),) if words is not None]
    return worse, better
