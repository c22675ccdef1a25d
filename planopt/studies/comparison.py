"""Paired comparison of settings on common seeds, and its files."""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from planopt.channel.calibration import ReliabilityBin
from planopt.errors import A_FOLDER, InputError, NoPlanError, path_of
from planopt.files.compare import DIGEST, differences, digest_of, in_words
from planopt.files.reading import read_text
from planopt.files.tables import require_pandas
from planopt.files.typed_json import decoded, encoded, finite
from planopt.files.writing import replaced_results, strict_text, write_text, write_whole
from planopt.planning.files.result_json import SummaryRecord, reliability_json
from planopt.planning.files.saved import PLAN_FILE, RUN_FILE
from planopt.planning.loop.results import NOT_DONE, RunSummary
from planopt.problems.problem import Problem
from planopt.problems.tasks import TaskProblem, problem_from, task_of
from planopt.short_repr import short_repr
from planopt.studies.comparison_rows import (
    Row,
    Setting,
    SettingKey,
    comparison_rows,
    runs_by_setting,
    runs_reliability,
    setting_of,
)
from planopt.studies.study import cpu_name, digest_of_tables, program

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COMPARISON_FILE, MANIFEST_FILE, RUNS_FILE = "comparison.json", "manifest.json", "runs.jsonl"
PARQUET_FILE = "runs.parquet"

COMPARISON = (
    *(COMPARISON_FILE, MANIFEST_FILE, RUNS_FILE, PARQUET_FILE),
    *("comparison.png", "reliability.png", "traces.png", "report.html"),
)
"""Names of all files of a comparison, including figures."""
MACHINE = frozenset(("program", "python", "machine"))
"""Keys of the manifest that describe the software and the machine."""

REMEDY = "run the comparison again"


@dataclass(frozen=True)
class Comparison:
    """Runs of a comparison and the table computed from them.

    Attributes
    ----------
    problem
        First problem; each run stores its changed keys.
    runs
        Runs, ordered by setting and then by seed.
    rows
        Table of metrics by setting.
    wall_s
        Wall time of the comparison.
    resumed
        Number of runs reused from an earlier comparison.
    others
        Further problems.
    """

    problem: Problem | TaskProblem
    runs: tuple[RunSummary, ...]
    rows: tuple[Row, ...]
    wall_s: float
    resumed: int = 0
    others: tuple[Problem | TaskProblem, ...] = ()

    __repr__ = short_repr

    def save(self, folder: Path | str, *, parquet: bool = False) -> None:
        """Save the comparison as a folder that :func:`planopt.load_result` reads.

        Parameters
        ----------
        folder
            Folder, created if missing; a comparison in it is replaced.
        parquet
            Whether to save the runs as ``runs.parquet`` as well, which needs pyarrow.

        Raises
        ------
        OutputError
            The folder cannot be written; its previous content is kept.
        InputError
            A problem has parts from Python, which cannot be saved, or pyarrow is missing.
        """
        if parquet:
            require_pyarrow()
        problems = (self.problem, *self.others)
        tables = [task_of(problem).tables(problem) for problem in problems]
        runs = "".join(strict_text(encoded(run)) for run in self.runs)
        data = {
            **comparison_json(self),
            DIGEST: digest_of(runs),
            "problem_file": tables[0],
            "other_problems": tables[1:],
        }
        with replaced_results(path_of("folder", folder, A_FOLDER), COMPARISON) as new:
            write_text(new / RUNS_FILE, runs)
            write_text(new / MANIFEST_FILE, strict_text(manifest(self, tables)))
            if parquet:
                write_whole(new / PARQUET_FILE, lambda path: _write_parquet(self, path))
            write_text(new / COMPARISON_FILE, strict_text(data))

    def plot(self) -> Figure:
        """Return a figure of every metric's mean and interval by setting; no window is opened."""
        # Imported by name because the package of figures depends on this one.
        return import_module("planopt.report").draw_comparison(self)

    def _repr_html_(self) -> str:
        """Return an HTML view for notebooks: figure and key numbers."""
        figures = [
            ("settings", len(self.settings)),
            ("runs", len(self.runs)),
            ("runs that completed the task", sum(run.exit_code != NOT_DONE for run in self.runs)),
            ("verified_rate", sum(run.verified_rate for run in self.runs) / len(self.runs)),
            ("wall_s", self.wall_s),
        ]
        name, notebook = self.problem.name, import_module("planopt.report.notebook")
        return notebook.summary_html(f"comparison of {name}", figures, self.plot())

    def to_dataframe(self) -> Any:
        """Return the runs as a pandas DataFrame: a row per run, a column per setting and metric.

        Raises
        ------
        InputError
            pandas is not installed.
        """
        return require_pandas().DataFrame(run_columns(self))

    @property
    def exit_code(self) -> int:
        """Return 0 if all runs completed, 3 if a step is not verified, 4 if a run failed."""
        return max(run.exit_code for run in self.runs)

    @property
    def settings(self) -> tuple[Setting, ...]:
        """Return the settings with their runs and rows, in the order of the rows."""
        found: dict[SettingKey, dict[str, Row]] = {setting_of(run): {} for run in self.runs}
        for row in self.rows:
            found[setting_of(row)][row.metric] = row
        # A setting whose runs have no metrics has no rows.
        every = runs_by_setting(self.runs)
        return tuple(Setting(each, found[setting_of(each[0])]) for each in every)

    @property
    def reliability(self) -> tuple[ReliabilityBin, ...]:
        """Return bins of predicted against true connection over all steps, runs and settings."""
        return runs_reliability(self.runs)


def save_no_comparison(problem: Problem | TaskProblem, message: str, folder: Path) -> None:
    """Save a result without a plan, in place of the previous comparison."""
    tables = task_of(problem).tables(problem)
    data = {**no_comparison_json(problem.name, message), "problem_file": tables}
    with replaced_results(folder, COMPARISON) as new:
        write_text(new / COMPARISON_FILE, strict_text(data))


def load_comparison(path: Path) -> Comparison | None:
    """Return a saved comparison; None for another kind of result."""
    folder = path.parent if path.name == COMPARISON_FILE else path
    others = (folder / name for name in (PLAN_FILE, RUN_FILE))
    named = path.name == COMPARISON_FILE
    if named or ((folder / COMPARISON_FILE).is_file() and not any(map(Path.is_file, others))):
        return _load_comparison(folder)
    return None


def comparison_reasons(path: Path) -> list[str] | None:
    """Return the contradictions between a saved comparison and its runs; None without one."""
    comparison = load_comparison(path)
    if comparison is None:
        return None
    folder = path.parent if path.name == COMPARISON_FILE else path
    saved: dict[str, Any] = json.loads(read_text(folder / COMPARISON_FILE))
    tables = {key: saved[key] for key in ("problem_file", "other_problems")}
    runs = digest_of(read_text(folder / RUNS_FILE))
    found = {**comparison_json(comparison), DIGEST: runs, **tables}
    reasons = in_words(COMPARISON_FILE, differences(saved, found, accepted=frozenset()))
    made: dict[str, Any] = json.loads(read_text(folder / MANIFEST_FILE))
    try:
        again = manifest(comparison, [tables["problem_file"], *tables["other_problems"]])
    except InputError as error:  # A map or log covered by the digests is missing
        return [*reasons, f"{MANIFEST_FILE}, key problems: {error}"]
    return reasons + in_words(MANIFEST_FILE, differences(made, again, accepted=MACHINE))


def _load_comparison(folder: Path) -> Comparison:
    file = folder / COMPARISON_FILE
    try:
        data = json.loads(read_text(file))
        if data["outcome"] == "no_plan":
            raise NoPlanError(str(data["message"]))
        problems = [
            problem_from(each, folder=folder.absolute(), file=file)
            for each in (data["problem_file"], *data["other_problems"])
        ]
        wall_s, resumed = float(data["wall_s"]), int(data["resumed"])
        file = folder / RUNS_FILE
        # Comparisons saved by early versions contain no traces.
        records = map(json.loads, read_text(file).splitlines())
        lines: list[dict[str, Any]] = [{"traces": {}, **record} for record in records]
        runs = tuple(decoded(RunSummary, line) for line in lines)
        if not runs:
            raise InputError("contains no run", file=file, remedy=REMEDY)
        rows = tuple(comparison_rows(runs))
    except (ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
        raise InputError(f"cannot be read: {error}", file=file, remedy=REMEDY) from None
    return Comparison(problems[0], runs, rows, wall_s, resumed, tuple(problems[1:]))


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """Return the JSON object that ``planopt compare`` prints."""
    return {
        "problem": comparison.problem.name,
        "outcome": "compared",
        "rows": encoded(comparison.rows),
        "reliability": {
            "all": reliability_json(comparison.reliability),
            "settings": [
                {**_setting_json(runs[0]), "bins": reliability_json(runs_reliability(runs))}
                for runs in runs_by_setting(comparison.runs)
            ],
        },
        "runs": [
            {"problem": run.problem, "sweep": run.sweep, **SummaryRecord.written(run)}
            for run in comparison.runs
        ],
        "wall_s": finite(comparison.wall_s),
        "resumed": comparison.resumed,
        "message": "",
    }


def no_comparison_json(name: str, message: str) -> dict[str, Any]:
    """Return the JSON object of ``planopt compare`` if there is no plan; `message` says why."""
    return {
        "problem": name,
        "outcome": "no_plan",
        "rows": [],
        "reliability": {"all": [], "settings": []},
        "runs": [],
        "wall_s": None,
        "resumed": 0,
        "message": message,
    }


def _setting_json(run: RunSummary) -> dict[str, Any]:
    names = "problem", "sweep", "horizon", "planner", "cost_to_go"
    return {name: getattr(run, name) for name in names}


def manifest(comparison: Comparison, tables: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the program, machine, seeds and settings needed to repeat the runs."""
    settings = runs_by_setting(comparison.runs)
    return {
        "program": dict(program()),
        "python": platform.python_version(),
        "machine": {"cpu": cpu_name(), "cores": os.cpu_count(), "system": platform.platform()},
        "problems": [
            {"name": each["problem"]["name"], "sha256": digest_of_tables(each)} for each in tables
        ],
        "settings": [_setting_json(runs[0]) for runs in settings],
        "seeds": [run.seed for run in settings[0]],
        "runs": len(comparison.runs),
        "wall_s": finite(comparison.wall_s),
        "resumed": comparison.resumed,
    }


def run_columns(comparison: Comparison) -> dict[str, list[Any]]:
    """Return the runs as columns: one row per run, one column per swept key and metric."""
    runs = comparison.runs
    swept = dict.fromkeys(key for run in runs for key in run.sweep)
    metrics = dict.fromkeys(name for run in runs for name in run.metrics)
    columns: dict[str, list[Any]] = {"problem": [run.problem for run in runs]}
    for key in swept:
        values = [run.sweep.get(key) for run in runs]
        kinds = {type(value).__name__ for value in values if value is not None}
        plain = len(kinds) == 1 and not kinds & {"list", "dict"}
        columns[key] = (
            values if plain else [None if each is None else json.dumps(each) for each in values]
        )
    for name in ("horizon", "planner", "cost_to_go", "seed", "outcome", "reason", "exit_code"):
        columns[name] = [getattr(run, name) for run in runs]
    columns["verified_rate"] = [float(run.verified_rate) for run in runs]
    for name in metrics:
        columns[name] = [float(run.metrics.get(name, math.nan)) for run in runs]
    columns["steps"] = [len(run.step_s) for run in runs]
    columns["step_s"] = [run.step_s.tolist() for run in runs]
    return columns


def require_pyarrow() -> None:
    """Raise an InputError with an installation hint if pyarrow is missing."""
    if find_spec("pyarrow") is None:
        raise InputError(
            "the package pyarrow, which writes Parquet files, is not installed",
            remedy="pip install 'planopt[parquet]'",
        )


def _write_parquet(comparison: Comparison, path: Path) -> None:
    arrow = cast("Any", import_module("pyarrow"))
    parquet = cast("Any", import_module("pyarrow.parquet"))
    parquet.write_table(arrow.table(run_columns(comparison)), path)
