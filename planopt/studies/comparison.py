"""Paired comparison of settings on common seeds: its table with intervals, and its files."""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from scipy.special import stdtrit

from planopt.arrays import Floats
from planopt.channel.calibration import FEWEST_GROUPS, ReliabilityBin, reliability
from planopt.errors import A_FOLDER, InputError, NoPlanError, path_of
from planopt.files.compare import DIGEST, differences, digest_of, in_words
from planopt.files.reading import read_text
from planopt.files.tables import decoded, encoded, finite, require_pandas
from planopt.files.writing import replaced_results, strict_text, write_text, write_whole
from planopt.planning.files.result_json import SummaryRecord, reliability_json
from planopt.planning.files.saved import PLAN_FILE, RUN_FILE
from planopt.planning.loop.metrics import ANY, POSSIBLE
from planopt.planning.loop.results import NOT_DONE, RunSummary
from planopt.problems.problem import Problem
from planopt.problems.settings import OWN
from planopt.problems.tasks import TaskProblem, problem_from, task_of
from planopt.short_repr import short_repr
from planopt.studies.study import cpu_name, digest_of_tables, program

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONFIDENCE = 0.95

SettingKey = tuple[str, str, str | None, str, int]
"""Key of a setting: problem, sweep as text, cost-to-go, planner and horizon."""


@dataclass(frozen=True)
class Row:
    """Statistics of one metric of one setting over all seeds; None for missing values."""

    horizon: int  # Planning horizon in steps
    planner: str
    cost_to_go: str | None
    seeds: int  # Number of runs
    stalled: int  # Number of runs that did not complete their task
    metric: str  # Such as ``goal_time_s``
    mean: float | None  # Mean over the `count` runs for which the metric exists
    ci_low: float | None
    ci_high: float | None
    count: int
    # Geometric mean over seeds of the ratio to the reference, if both are positive
    paired_ratio: float | None
    verified_rate: float | None  # Share of released steps that were verified, over all runs
    p50_step_s: float | None  # Median and 95 % quantile of the planning time per step
    p95_step_s: float | None
    # Mean over seeds of the difference from the reference, if both exist
    paired_difference: float | None = None
    difference_low: float | None = None
    difference_high: float | None = None
    ratio_low: float | None = None  # Interval of the paired ratio, computed on logarithms
    ratio_high: float | None = None
    problem: str = ""
    sweep: Mapping[str, Any] = field(default_factory=dict[str, Any])  # Values of changed keys


@dataclass(frozen=True)
class Setting:
    """Setting of a comparison, with its runs and rows."""

    runs: Sequence[RunSummary]  # Ordered by seed
    rows: Mapping[str, Row]  # By metric

    @property
    def one(self) -> RunSummary:
        """Return the first run of the setting, which describes the setting."""
        return self.runs[0]

    @property
    def stalled(self) -> int:
        """Return the number of runs that did not complete their task."""
        return sum(run.exit_code == NOT_DONE for run in self.runs)


def comparison_rows(runs: Sequence[RunSummary]) -> list[Row]:
    """Return the rows of all settings; each setting needs runs of the same seeds in order."""
    # If every problem has one setting, the first of all is the reference.
    settings = runs_by_setting(runs)
    first = {each[0].problem: each for each in reversed(settings)}
    if len(first) == len(settings):
        first = dict.fromkeys(first, settings[0])
    return [row for each in settings for row in tabulate(each, first[each[0].problem])]


def tabulate(runs: Sequence[RunSummary], reference: Sequence[RunSummary]) -> list[Row]:
    """Return one row per metric of `runs`; `reference` has runs of the same seeds in order."""
    one = runs[0]
    steps = np.concatenate([run.step_s for run in runs])
    rates = np.array([run.verified_rate for run in runs])
    released = np.array([sum(run.rungs.values()) for run in runs], dtype=float)
    known = np.isfinite(rates)
    count = released[known].sum()
    rate = float(rates[known] @ released[known] / count) if count else 1.0
    rows: list[Row] = []
    for metric in dict.fromkeys(name for run in runs for name in run.metrics):
        values, others = (
            np.array([run.metrics.get(metric, np.nan) for run in each], dtype=float)
            for each in (runs, reference)
        )
        there = values[np.isfinite(values)]
        low, high = mean_interval(there, POSSIBLE.get(metric, ANY))
        differences = (values - others)[np.isfinite(values) & np.isfinite(others)]
        difference_low, difference_high = mean_interval(differences)
        ratios = log_ratios(values, others)
        ratio_low, ratio_high = (
            None if end is None else float(np.exp(end)) for end in mean_interval(ratios)
        )
        rows.append(
            Row(
                horizon=one.horizon,
                planner=one.planner,
                cost_to_go=one.cost_to_go,
                seeds=len(runs),
                stalled=sum(run.exit_code == NOT_DONE for run in runs),
                metric=metric,
                mean=float(there.mean()) if there.size else None,
                ci_low=low,
                ci_high=high,
                count=int(there.size),
                paired_ratio=float(np.exp(ratios.mean())) if ratios.size else None,
                verified_rate=rate if known.any() else None,
                p50_step_s=float(np.median(steps)) if steps.size else None,
                p95_step_s=float(np.quantile(steps, 0.95)) if steps.size else None,
                paired_difference=float(differences.mean()) if differences.size else None,
                difference_low=difference_low,
                difference_high=difference_high,
                ratio_low=ratio_low,
                ratio_high=ratio_high,
                problem=one.problem,
                sweep=one.sweep,
            )
        )
    return rows


def mean_interval(
    values: Floats, possible: tuple[float, float] = ANY
) -> tuple[float | None, float | None]:
    """Return the clipped Student interval of the mean; None for too few values."""
    if values.size < FEWEST_GROUPS:
        return None, None
    quantile = np.asarray(stdtrit(values.size - 1, 0.5 + CONFIDENCE / 2))
    half = float(quantile) * float(values.std(ddof=1)) / float(np.sqrt(values.size))
    mean = float(values.mean())
    least, largest = possible
    return max(mean - half, least), min(mean + half, largest)


def log_ratios(values: Floats, others: Floats) -> Floats:
    """Return the logarithms of paired ratios, restricted to positive finite pairs."""
    both = np.isfinite(values) & np.isfinite(others) & (values > 0.0) & (others > 0.0)
    return np.log(values[both] / others[both])


def runs_reliability(runs: Sequence[RunSummary]) -> tuple[ReliabilityBin, ...]:
    """Return the reliability bins of P(connected) over all steps of runs, grouped by seed."""
    seeds = [np.full(len(run.connectivity), run.seed, dtype=np.intp) for run in runs]
    return reliability(
        np.concatenate([run.connectivity for run in runs]),
        np.concatenate([run.connected for run in runs]),
        np.concatenate(seeds),
    )


def runs_by_setting(runs: Sequence[RunSummary]) -> list[list[RunSummary]]:
    """Return the runs grouped by setting, in order of first occurrence."""
    found: dict[SettingKey, list[RunSummary]] = {}
    for run in runs:
        found.setdefault(setting_of(run), []).append(run)
    return list(found.values())


def setting_of(one: RunSummary | Row) -> SettingKey:
    """Return the key of a run's setting."""
    return one.problem, sweep_words(one), one.cost_to_go, one.planner, one.horizon


def has_horizon(one: RunSummary | Row) -> bool:
    """Return whether the planner has a horizon; False if it optimises the whole run."""
    kind = OWN.get(one.planner)
    return kind is None or not kind.foresees


def sweep_words(
    one: RunSummary | Row, left_out: str | None = None, names: Mapping[str, str] | None = None
) -> str:
    """Return the changed keys of a run's setting and their values as text."""
    called = names or {}
    return ", ".join(
        f"{called.get(key, key)} = {value}" for key, value in one.sweep.items() if key != left_out
    )


def setting_words(comparison: Comparison) -> list[str]:
    """Return text that identifies each setting of a comparison."""
    names, found = short_keys(comparison.runs), list[str]()
    for one in (setting.one for setting in comparison.settings):
        own = {
            "objective.cost_to_go": one.cost_to_go and f"{one.cost_to_go} cost-to-go",
            "planner.name": f"planner {one.planner}",
            "planner.horizon": f"horizon {one.horizon}" if has_horizon(one) else None,
        }
        parts = (
            one.problem if comparison.others else None,
            sweep_words(one, names=names),
            *(words for key, words in own.items() if key not in one.sweep),
        )
        found.append(", ".join(part for part in parts if part))
    return found


def short_keys(settings: Iterable[RunSummary | Row]) -> dict[str, str]:
    """Return short names of the swept keys: their shortest unambiguous suffixes."""
    keys = list(dict.fromkeys(key for one in settings for key in one.sweep))
    found = {key: key for key in keys}
    if len(keys) > 1:
        for key in keys:
            for count in range(key.count(".") + 1, 0, -1):
                end = ".".join(key.split(".")[-count:])
                if sum(f".{other}".endswith(f".{end}") for other in keys) == 1:
                    found[key] = end
    return found


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
                arrow, written = (
                    cast("Any", import_module(name)) for name in ("pyarrow", "pyarrow.parquet")
                )
                table = arrow.table(run_columns(self))
                write_whole(new / PARQUET_FILE, partial(written.write_table, table))
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
        name, notebook = self.problem.name, import_module("planopt.report.page_content")
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
        """Return the reliability bins of P(connected) over all steps, runs and settings."""
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
