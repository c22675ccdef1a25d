"""Folder of the regression suite: a manifest and one file per row.

The manifest ``bench.json`` identifies program and problems. A folder made by another program or
with changed problems is rejected because its rows are not comparable.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import groupby
from pathlib import Path
from typing import Any

from planopt.errors import InputError
from planopt.files.reading import read_text
from planopt.files.typed_json import decoded, encoded
from planopt.files.writing import strict_text, write_text
from planopt.planning import tolerances
from planopt.problems.load import load
from planopt.studies.bench_cases import Case, Row, answer, key_of, start_of
from planopt.studies.bench_references import OBJECTIVE_SHARE
from planopt.studies.study import FinishedRuns, Study, cpu_name, program, run_key, run_study

MANIFEST, ROWS, TABLE = "bench.json", "rows", "rows.csv"

STUDY = Study(kind=Row, prepare=start_of, work=answer, key=key_of)
"""Functions that compute the rows."""


@dataclass(frozen=True)
class Manifest:
    """Versions, machine and settings that produced the rows of a folder."""

    # Versions of planopt and of the libraries that affect results, and a digest of the source
    program: dict[str, str]
    python: str  # Python version
    cpu: str
    cores: int
    # Tolerances of planner and verifier, and the smallest significant change of an objective
    tolerances: dict[str, float]
    problems: dict[str, str]  # Digest of every problem and of the files that it refers to, by name

    @property
    def made_by(self) -> str:
        """Return the program as text, for references."""
        return f"planopt {self.program['planopt']}, source {self.program['source'][:12]}"


def manifest_of(problems: Sequence[str]) -> Manifest:
    """Return the manifest for some problems on this machine."""
    known = {
        name.lower(): float(value)
        for name, value in vars(tolerances).items()
        if name.isupper() and isinstance(value, float)
    }
    return Manifest(
        program=dict(program()),
        python=platform.python_version(),
        cpu=cpu_name(),
        cores=os.cpu_count() or 1,
        tolerances={**known, "objective_share": OBJECTIVE_SHARE},
        problems={name: _problem_digest(name) for name in problems},
    )


def answers(
    cases: Sequence[Case],
    *,
    workers: int = 1,
    record: FinishedRuns | None = None,
    on_row: Callable[[Row], None] | None = None,
) -> list[Row]:
    """Solve cases and return their rows in order; one belief serves each problem and seed."""
    groups = [
        list(group)
        for _, group in groupby(cases, lambda case: (case.question.problem, case.question.seed))
    ]
    rows: list[Row] = []
    for results in run_study(STUDY, groups, workers=workers, record=record):
        for one in results:
            rows.append(one.result)
            if on_row is not None:
                on_row(one.result)
    return rows


def run_into(
    folder: Path,
    cases: Sequence[Case],
    *,
    workers: int = 1,
    on_row: Callable[[Row], None] | None = None,
) -> list[Row]:
    """Solve cases and store their rows in a folder; rows that are already there are reused."""
    now = manifest_of(list(dict.fromkeys(case.question.problem for case in cases)))
    if (folder / MANIFEST).exists():
        before = read_manifest(folder)
        _require_same(before, now, folder)
        now = replace(now, problems={**before.problems, **now.problems})
    write_text(folder / MANIFEST, strict_text(encoded(now)))
    rows = answers(cases, workers=workers, record=FinishedRuns(folder / ROWS), on_row=on_row)
    write_text(folder / TABLE, rows_csv(read_rows(folder)))
    return rows


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a folder."""
    file = folder / MANIFEST
    try:
        return decoded(Manifest, json.loads(read_text(file)))
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(
            "is damaged", file=file, remedy="run planopt bench run into another folder"
        ) from None


def read_rows(folder: Path) -> list[Row]:
    """Return all rows of a folder, sorted by case; rows with invalid numbers are skipped."""
    rows = FinishedRuns(folder / ROWS).all(Row)
    return sorted((row for row in rows if _is_possible(row)), key=lambda row: row.case)


def _is_possible(row: Row) -> bool:
    """Return whether every number of a row is valid."""
    least_zero = (row.iterations, row.solve_s, row.wall_s, row.cpu_s, row.steps)
    counts = all(count >= 0 for count in row.rungs.values())
    known = (row.objective, row.kkt_residual, row.min_clearance_m, row.min_connectivity)
    numbers = [*least_zero, *(value for value in known if value is not None)]
    return counts and min(least_zero) >= 0 and all(map(math.isfinite, numbers))


def rows_csv(rows: Sequence[Row]) -> str:
    """Return rows as a CSV table; lists and tables are JSON in their cells."""
    text = io.StringIO()
    names = [part.name for part in fields(Row) if part.name != "states"]
    table = csv.writer(text, lineterminator="\n")
    table.writerow(names)
    for row in rows:
        values = [getattr(row, name) for name in names]
        table.writerow([json.dumps(v) if isinstance(v, dict | tuple) else v for v in values])
    return text.getvalue()


def _require_same(before: Manifest, now: Manifest, folder: Path) -> None:
    """Reject a folder whose rows are not comparable with new ones."""
    remedy = "choose another --out, or remove this folder"
    changed = [
        f"{name} {old}, this is {now.program.get(name)}"
        for name, old in before.program.items()
        if now.program.get(name) != old
    ]
    if changed:
        words = ", ".join(words.replace("source ", "the source ") for words in changed)
        raise InputError(f"was made by another program: {words}", file=folder, remedy=remedy)
    for name, digest in now.problems.items():
        if before.problems.get(name, digest) != digest:
            raise InputError(
                f"was made of another problem {name}: its file has changed since",
                file=folder,
                remedy=remedy,
            )


def _problem_digest(name: str) -> str:
    tables: Mapping[str, Any] = run_key(load(name), 0)["problem"]
    return hashlib.sha256(strict_text(tables).encode()).hexdigest()[:16]
