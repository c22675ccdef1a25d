"""Cases of the regression suite, and the folder of their result rows.

The manifest ``bench.json`` identifies program and problems; rows of others are not comparable.
"""

import csv
import io
import json
import math
import os
import platform
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import groupby
from pathlib import Path
from time import process_time
from typing import Any

from planopt.arrays import proof_seconds
from planopt.bounds.bound import GAP_TOLERANCE
from planopt.channel.cholesky import one_blas_thread
from planopt.errors import InputError, NoPlanError
from planopt.files.compare import digest_of
from planopt.files.reading import read_text
from planopt.files.tables import decoded, encoded
from planopt.files.writing import strict_text, write_text
from planopt.planning import tolerances
from planopt.planning.plan import Termination, Verdict
from planopt.problems.library import list_problems
from planopt.problems.load import load
from planopt.problems.settings import planner_kind, planner_names
from planopt.problems.tasks import task_of
from planopt.studies.study import (
    AnyProblem,
    FinishedRuns,
    Study,
    cpu_name,
    program,
    run_key,
    run_study,
    shared_data,
)

PLAN, RUN = "plan", "run"  # Kinds of cases: one plan from the start, or a closed loop
States = tuple[tuple[tuple[float, ...], ...], ...]
"""States of the robots at each step."""
HORIZONS = (5, 20)  # Planning horizons in steps, used in addition to the problem's own
OBJECTIVE_SHARE = 0.01  # Relative difference above which an objective counts as worse than another
PLANNED, NO_PLAN, ERROR = "planned", "no_plan", "error"
"""Outcomes of cases: a plan, a proof that no plan exists, or an error."""


@dataclass(frozen=True, order=True)
class Question:
    """Planning task of the benchmark, which several planners solve."""

    problem: str  # Name in the library, or path of a problem file
    kind: str  # ``plan`` or ``run``
    cost_to_go: str  # Empty if there is no goal
    horizon: int  # Planning horizon in steps
    seed: int  # Random seed

    def __str__(self) -> str:
        """Return text that identifies the planning task."""
        cost = f"{self.cost_to_go} cost-to-go, " if self.cost_to_go else ""
        return f"{self.problem}, {self.kind}, {cost}horizon {self.horizon}, seed {self.seed}"


@dataclass(frozen=True, order=True)
class Case:
    """Benchmark case: a planning task and the planner that solves it."""

    question: Question
    planner: str
    # States imposed on the robots of a closed loop; empty if they follow their plans
    states: States = field(default=(), compare=False)
    # Time in seconds for a proven bound on the objective of a plan; 0 for none
    prove_s: float = field(default=0.0, compare=False)

    def __str__(self) -> str:
        """Return text that identifies the case."""
        return f"{self.question}, planner {self.planner}"


def library_cases(
    problems: Sequence[str] | None = None,
    *,
    planners: Sequence[str] | None = None,
    horizons: Sequence[int] | None = None,
    seeds: Iterable[int] = range(3),
    run_seeds: Iterable[int] = range(1),
    prove_s: float = 0.0,
) -> list[Case]:
    """Return the cases of all valid combinations, ordered by problem and then by seed."""
    prove_s = proof_seconds(prove_s) if prove_s else 0.0
    loaded = {name: load(name) for name in (library_names() if problems is None else problems)}
    chosen = {
        (name, kind): task_of(problem).planners(problem, kind)
        for name, problem in loaded.items()
        for kind in (PLAN, RUN)
    }
    known = dict.fromkeys([*planner_names(), *(each for own in chosen.values() for each in own)])
    for name in planners or ():
        if name not in known:
            raise InputError(
                f"has the unknown planner {name!r}",
                key="planners",
                remedy=f"use one of {', '.join(known)}",
            )
    each, driven = list(seeds), list(run_seeds)
    cases: list[Case] = []
    for name, problem in loaded.items():
        task = task_of(problem)
        own, _, own_cost = task.labels(problem)
        ahead, costs = [own], [own_cost]
        if task.plans_ahead:
            ahead = sorted({own, *HORIZONS}) if horizons is None else list(dict.fromkeys(horizons))
            costs = task.compared_costs_to_go(problem)
        for horizon in ahead if task.plans_ahead else ():
            task.overridden(problem, horizon=horizon)
        # Designs use no random numbers.
        planned = each[:1] if task.simulate is None else each
        for seed in sorted({*each, *driven}):
            for kind, seeds_of_kind, settings in (
                (PLAN, planned, [(cost, horizon) for cost in costs for horizon in ahead]),
                (RUN, driven, [(own_cost, own)]),
            ):
                allowed = chosen[name, kind]
                cases += [
                    Case(Question(name, kind, cost or "", horizon, seed), planner, prove_s=prove_s)
                    for cost, horizon in settings
                    for planner in (planners or allowed)
                    if planner in allowed and seed in seeds_of_kind
                ]
    if not cases:
        raise InputError(
            "has no planner that supports one of the problems",
            key="planners",
            remedy="choose other planners or other problems",
        )
    return cases


def library_names(tasks: Collection[str] | None = None) -> list[str]:
    """Return the names of library problems whose data are available, by default of all tasks."""
    return [
        entry.name
        for entry in list_problems()
        if not entry.lacks_data and (tasks is None or entry.task in tasks)
    ]


def problem_of(case: Case) -> AnyProblem:
    """Return the problem of a case with the case's settings."""
    question = case.question
    problem = load(question.problem)
    if case.planner == problem.task:
        return problem
    return task_of(problem).overridden(
        problem,
        horizon=question.horizon,
        planner=case.planner,
        cost_to_go=question.cost_to_go or None,
    )


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Result of a benchmark case: values summed over robots, distances of the worst robot."""

    problem: str
    kind: str
    cost_to_go: str
    horizon: int
    seed: int
    planner: str
    sense: str  # ``max`` or ``min``: direction of the objective
    objective: float | None = None  # Objective of a plan, or the mean over the plans of a run
    verdict: str = Verdict.NONE.value  # Verdict reported by the planner; for a run the worst
    outcome: str = ""  # planned, no_plan or error
    rungs: dict[str, int] = field(default_factory=dict[str, int])  # Number of steps by fallback
    # Proven bound in the unit of the objective, and the relative gap to it; None if none is proven
    bound: float | None = None
    gap: float | None = None
    # CPU time of the case, excluding channel simulation, channel fit and scene construction
    cpu_s: float = 0.0
    # States of the robots of a run after each step; the check plans from the same states, so that
    # rounding differences between processors do not accumulate
    states: States = ()

    @property
    def question(self) -> Question:
        """Planning task of this result, without its planner."""
        return Question(self.problem, self.kind, self.cost_to_go, self.horizon, self.seed)

    @property
    def case(self) -> Case:
        """Benchmark case that produced this result."""
        return Case(self.question, self.planner, self.states)


@dataclass(frozen=True, kw_only=True)
class Row(Answer):
    """Result row of one benchmark case, with the findings of the check."""

    termination: str = ""
    # Whether planopt check accepts the saved files; None if nothing was saved
    accepted: bool | None = None
    reasons: tuple[str, ...] = ()  # Objections of the check, or the error
    iterations: int = 0  # Solver iterations
    solve_s: float = 0.0
    wall_s: float = 0.0
    steps: int = 0  # Number of plans, one per step and robot
    # Number of plans later than planner.budget_s, or than planner.step_s without a budget; None if
    # the task has no deadline
    late: int | None = None
    path_digest: str = ""  # Digest of all positions, rounded to 1 mm
    kkt_residual: float | None = None  # From the certificate; None for a run
    min_clearance_m: float | None = None
    min_connectivity: float | None = None


def start_of(case: Case) -> Any:
    """Return the data shared by all cases of a problem and seed, or why they cannot be prepared."""
    return shared_data((problem_of(case), case.question.seed))


def key_of(case: Case) -> dict[str, Any]:
    """Return the key of a row: all data that determine it."""
    is_motion_planner = case.planner in planner_names()
    return {
        **run_key(problem_of(case), case.question.seed),
        "planner_version": planner_kind(case.planner).version if is_motion_planner else "",
        "kind": case.question.kind,
        "name": case.question.problem,
        "states": encoded(case.states),
        "prove_s": case.prove_s,
    }


@one_blas_thread()
def answer(case: Case, shared: Any) -> Row:
    """Return the result row of a case, solved by its problem's task; an error also gives a row."""
    problem, question = problem_of(case), case.question
    task = task_of(problem)
    no_path = "" if question.kind == RUN else Termination.NO_PATH.value
    sense = getattr(problem, "sense", "min")
    row = Row(**asdict(question), planner=case.planner, sense=sense, termination=no_path)
    begun = process_time()
    try:
        if isinstance(shared, NoPlanError):
            raise shared
        found: Mapping[str, Any] = task.answer(
            problem, question.kind, question.seed, shared, case.states, case.prove_s
        )
    except NoPlanError as error:
        found = {"outcome": NO_PLAN, "reasons": (str(error),)}
    except Exception as error:
        found = {"outcome": ERROR, "reasons": (f"{type(error).__name__}: {error}",)}
    return within_bound(replace(row, **{"cpu_s": process_time() - begun, **found}))


def within_bound(row: Row) -> Row:
    """Return a row, marked as rejected if its objective violates its proven bound."""
    if row.gap is None or row.gap >= -GAP_TOLERANCE or row.verdict != Verdict.VERIFIED.value:
        return row
    words = f"the plan is better than its proven bound {row.bound:.6g}: the gap is {row.gap:.2g}"
    return replace(row, accepted=False, reasons=(*row.reasons, words))


MANIFEST, ROWS, TABLE = "bench.json", "rows", "rows.csv"

STUDY = Study(kind=Row, prepare=start_of, work=answer, key=key_of)
"""Study that computes the rows of all cases."""


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
        """Return a description of the program that computed the rows, for references."""
        return f"planopt {self.program['planopt']}, source {self.program['source'][:12]}"


def manifest_of(problems: Sequence[str]) -> Manifest:
    """Return the manifest of a benchmark of `problems`: program, machine and settings."""
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
        problems={
            name: digest_of(strict_text(run_key(load(name), 0)["problem"])) for name in problems
        },
    )


def answers(
    cases: Sequence[Case],
    *,
    workers: int = 1,
    record: FinishedRuns | None = None,
    on_row: Callable[[Row], None] | None = None,
) -> list[Row]:
    """Return the rows of cases in order; cases of one problem and seed share a belief."""
    groups = [
        list(group)
        for _, group in groupby(cases, lambda case: (case.question.problem, case.question.seed))
    ]
    rows: list[Row] = []
    for results in run_study(STUDY, groups, workers=workers, record=record):
        for row, _ in results:
            rows.append(row)
            if on_row is not None:
                on_row(row)
    return rows


def run_into(
    folder: Path,
    cases: Sequence[Case],
    *,
    workers: int = 1,
    on_row: Callable[[Row], None] | None = None,
) -> list[Row]:
    """Return the rows of cases, stored in a folder; rows already in the folder are reused."""
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
    """Return the manifest of a folder."""
    file = folder / MANIFEST
    try:
        return decoded(Manifest, json.loads(read_text(file)))
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(
            "is damaged", file=file, remedy="run planopt bench run with another folder"
        ) from None


def read_rows(folder: Path) -> list[Row]:
    """Return all rows of a folder, sorted by case; rows with invalid numbers are skipped."""
    found: list[Row] = []
    for row in FinishedRuns(folder / ROWS).all(Row):
        counts = (
            row.iterations,
            row.solve_s,
            row.wall_s,
            row.cpu_s,
            row.steps,
            *row.rungs.values(),
        )
        known = (row.objective, row.kkt_residual, row.min_clearance_m, row.min_connectivity)
        numbers = [*counts, *(v for v in (*known, row.bound, row.gap, row.late) if v is not None)]
        if min(counts) >= 0 and all(map(math.isfinite, numbers)):
            found.append(row)
    return sorted(found, key=lambda row: row.case)


def rows_csv(rows: Sequence[Row]) -> str:
    """Return rows as a CSV table; cells contain lists and tables as JSON."""
    text = io.StringIO()
    names = [part.name for part in fields(Row) if part.name != "states"]
    table = csv.writer(text, lineterminator="\n")
    table.writerow(names)
    for row in rows:
        values = [getattr(row, name) for name in names]
        table.writerow([json.dumps(v) if isinstance(v, dict | tuple) else v for v in values])
    return text.getvalue()


def _require_same(before: Manifest, now: Manifest, folder: Path) -> None:
    """Raise an InputError for a folder whose rows are not comparable with new ones."""
    remedy = "choose another --out, or remove this folder"
    changed = [
        f"{name} {old}, this is {now.program.get(name)}"
        for name, old in before.program.items()
        if now.program.get(name) != old
    ]
    if changed:
        words = ", ".join(words.replace("source ", "the source ") for words in changed)
        raise InputError(
            f"was written by another version of the program: {words}", file=folder, remedy=remedy
        )
    for name, digest in now.problems.items():
        if before.problems.get(name, digest) != digest:
            raise InputError(
                f"contains results of the problem {name}, whose file has changed since",
                file=folder,
                remedy=remedy,
            )
