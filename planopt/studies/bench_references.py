"""References of the regression suite (best known results of planners), and scores of planners."""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from planopt.arrays import Floats
from planopt.bounds.bound import relative_gap
from planopt.errors import InputError
from planopt.files.reading import read_text
from planopt.files.tables import decoded, encoded
from planopt.files.writing import write_text
from planopt.planning.plan import Rung, Termination, Verdict
from planopt.problems.library import library_folder
from planopt.problems.load import load
from planopt.problems.tasks import task_of
from planopt.studies.bench_cases import (
    ERROR,
    NO_PLAN,
    OBJECTIVE_SHARE,
    PLAN,
    RUN,
    Answer,
    Case,
    Question,
    Row,
    library_names,
)

DIGITS = 9  # Significant digits of stored objectives
FAST_SEED = 0  # Random seed of the cases in the fast subset
FAST_PLANNERS = ("auto", "scp", "lattice")  # Planners whose plans are in the fast subset
FAST_CPU_S = 3.0  # Maximum stored CPU time, in seconds, of other cases in the fast subset

_ABOUT = (
    "Best known results of the solver regression suite, one a line: planopt bench report DIR "
    "--freeze FILE. They change in commits of their own that list each number and why."
)


@dataclass(frozen=True, kw_only=True)
class Reference(Answer):
    """Best known result of a planner for a case."""

    made_by: str  # Program that produced the result


References = Mapping[Case, Reference]


def references_file() -> Path:
    """Return the file of the library's references."""
    return library_folder() / "references.json"


def read_references(file: Path | None = None) -> dict[Case, Reference]:
    """Return the references in a file, by default the library's."""
    path = references_file() if file is None else file
    try:
        listed = json.loads(read_text(path))["references"]
        found = decoded(list[Reference], listed)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(
            f"cannot be read as references of this version ({error})",
            file=path,
            remedy="restore the file from the repository",
        ) from None
    if not all(math.isfinite(one.objective or 0.0) and one.cpu_s >= 0.0 for one in found):
        raise InputError(
            "has a number that is NaN, infinite or negative",
            file=path,
            remedy="restore the file, or run the suite again",
        )
    references = {one.case: one for one in found}
    if len(references) < len(found):
        raise InputError("has two entries for one case", file=path, remedy="remove one of them")
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
    """Return a reference with the results of a row."""
    names = [part.name for part in fields(Reference) if part.name != "made_by"]
    kept: dict[str, Any] = {name: getattr(row, name) for name in names}
    for name in ("objective", "bound", "gap"):
        if kept[name] is not None:
            kept[name] = float(f"{kept[name]:.{DIGITS}g}")
    kept["cpu_s"] = round(row.cpu_s, 2)
    return Reference(**kept, made_by=made_by)


def frozen(
    known: References, rows: Iterable[Row], made_by: str
) -> tuple[dict[Case, Reference], list[str]]:
    """Return the references, updated by all successful rows, and a list of changes."""
    references = dict(known)
    changes: list[str] = []
    for row in rows:
        if row.accepted is False or row.outcome == "error":
            changes.append(f"{row.case}: left out, {'; '.join(row.reasons)}")
            continue
        new, old = reference_of(row, made_by), references.get(row.case)
        if old is not None:
            # A bound that is no tighter than the known one does not replace it.
            bounds = [each for each in (old.bound, new.bound) if each is not None]
            tightest = max if new.sense == "min" else min
            if bounds and tightest(bounds) == old.bound:
                new = replace(new, bound=old.bound, gap=old.gap)
            changed = [
                f"{name} {getattr(old, name)} -> {getattr(new, name)}"
                for name in ("objective", "verdict", "outcome", "rungs", "bound")
                if getattr(old, name) != getattr(new, name)
            ]
            if not changed:
                continue
            changes.append(f"{row.case}: {', '.join(changed)}")
        references[row.case] = new
    return references, changes


def bounds_known(references: References, rows: Iterable[Row] = ()) -> dict[Question, float]:
    """Return the tightest proven bound of each planning task."""
    found: dict[Question, float] = {}
    for one in (*references.values(), *rows):
        if one.bound is not None:
            tightest = max if one.sense == "min" else min
            found[one.case.question] = tightest(one.bound, found.get(one.case.question, one.bound))
    return found


def worse_share(objective: float, best: float, sense: str) -> float:
    """Return the relative amount by which an objective is worse than `best`; negative if better."""
    worse = objective - best if sense == "min" else best - objective
    return worse / max(abs(best), 1e-12)


def best_known(references: References, rows: Iterable[Row] = ()) -> dict[Question, float]:
    """Return each task's best objective among verified results that passed the check."""
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
    """Return descriptions of all metrics in which a row is worse than its reference."""
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
                f"objective {row.objective:.6g}, was {reference.objective:.6g}: "
                f"{100.0 * share:.1f} % worse"
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
        f"{100.0 * share:.1f} % better"
    )


def fast_cases(
    references: References, problems: Sequence[str] | None = None
) -> tuple[list[Case], list[str]]:
    """Return the cases of the fast subset, and a list of missing references."""
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
    """Return descriptions of all regressions and of all improvements of rows."""
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


SHIFT_S = 0.01
"""Shift of the geometric mean of times in seconds; differences far below it are negligible."""
LIMIT_S = 10.0  # Time in seconds per step that is assigned to unsolved cases
CONVERGED = (Termination.CONVERGED.value, Termination.ACCEPTABLE.value)
"""Solver terminations that claim an optimum."""


@dataclass(frozen=True)
class Score:
    """Scores of one planner over all cases of a benchmark."""

    planner: str
    cases: int
    success_rate: float  # Share of solved cases (:func:`is_solved`)
    # Share of correct claims (:func:`claims`, :func:`is_wrong`); None if the planner claims nothing
    correct_rate: float | None
    verified_rate: float  # Share of cases with verdict ``verified``
    rejected: int  # Number of verified plans that the check rejects
    errors: int  # Number of cases that ended with an error
    fallback_share: float  # Share of released plans from a fallback other than ``plan``
    # Relative excess of objectives over the best known; None if none is known
    median_excess: float | None
    largest_excess: float | None
    # Number of proven bounds, and relative gaps between the objectives and them
    bounds: int
    median_gap: float | None
    largest_gap: float | None
    iterations: float  # Mean number of solver iterations per plan
    # CPU time per plan in s: shifted geometric mean (unsolved: `LIMIT_S`), and median
    mean_s: float
    median_s: float | None
    # Number of plans with a deadline, and of those that missed it
    plans: int
    late: int


def excess(row: Row, best: Mapping[Question, float]) -> float | None:
    """Return the relative loss of a row's objective against the best known; None if unknown."""
    known = best.get(row.question)
    if known is None or row.objective is None:
        return None
    return worse_share(row.objective, known, row.sense)


def gap_to_bound(row: Row) -> float | None:
    """Return the relative gap between a row's objective and its proven bound; None without one."""
    if row.objective is None or row.bound is None:
        return None
    return relative_gap(row.objective, row.bound, "min" if row.sense == "min" else "max")


def is_solved(row: Row, best: Mapping[Question, float]) -> bool:
    """Return whether a result is verified and near the best, or rightly reports no plan."""
    if row.outcome == NO_PLAN:
        return row.question not in best
    if row.verdict != Verdict.VERIFIED.value or row.accepted is False or row.outcome == ERROR:
        return False
    worse = excess(row, best)
    return worse is None or worse <= OBJECTIVE_SHARE


def claims(row: Row) -> bool:
    """Return whether a planner claims a verified plan, an optimum, or that no plan exists."""
    verified = row.verdict == Verdict.VERIFIED.value
    return verified or row.termination in CONVERGED or row.outcome == NO_PLAN


def is_wrong(row: Row, best: Mapping[Question, float]) -> bool:
    """Return whether a claim is false: plan rejected, optimum missed, or existing plan denied."""
    if row.outcome == NO_PLAN:
        return row.question in best
    if row.verdict == Verdict.VERIFIED.value and row.accepted is False:
        return True
    worse = excess(row, best)
    return row.termination in CONVERGED and worse is not None and worse > OBJECTIVE_SHARE


def scores(rows: Sequence[Row], best: Mapping[Question, float]) -> list[Score]:
    """Return the scores of all planners, in order of first occurrence."""
    planners = dict.fromkeys(row.planner for row in rows)
    return [_score(name, [row for row in rows if row.planner == name], best) for name in planners]


def _score(planner: str, rows: Sequence[Row], best: Mapping[Question, float]) -> Score:
    solved = np.array([is_solved(row, best) for row in rows])
    claimed = [row for row in rows if claims(row)]
    wrong = sum(is_wrong(row, best) for row in claimed)
    verified = [row for row in rows if row.verdict == Verdict.VERIFIED.value]
    worse = [share for share in (excess(row, best) for row in rows) if share is not None]
    gaps = [gap for gap in map(gap_to_bound, rows) if gap is not None]
    steps = sum(row.steps for row in rows)
    direct = sum(row.rungs.get(Rung.PLAN.value, 0) for row in rows)
    times_s = np.array([step_s(row) for row in rows])
    return Score(
        planner=planner,
        cases=len(rows),
        success_rate=float(solved.mean()),
        correct_rate=1.0 - wrong / len(claimed) if claimed else None,
        verified_rate=len(verified) / len(rows),
        rejected=sum(row.accepted is False for row in verified),
        errors=sum(row.outcome == ERROR for row in rows),
        fallback_share=1.0 - direct / steps if steps else 0.0,
        median_excess=float(np.median(worse)) if worse else None,
        largest_excess=max(worse, default=None),
        bounds=len(gaps),
        median_gap=float(np.median(gaps)) if gaps else None,
        largest_gap=max(gaps, default=None),
        iterations=sum(row.iterations for row in rows) / steps if steps else 0.0,
        mean_s=shifted_geometric_mean(np.where(solved, times_s, LIMIT_S), SHIFT_S),
        median_s=float(np.median(times_s[solved])) if solved.any() else None,
        plans=sum(row.steps for row in rows if row.late is not None),
        late=sum(row.late or 0 for row in rows),
    )


def step_s(row: Row) -> float:
    """Return the CPU time of a row per plan, in seconds."""
    return row.cpu_s / max(row.steps, 1)


def shifted_geometric_mean(times_s: Floats, shift_s: float) -> float:
    """Return the shifted geometric mean exp(mean(log(t + s))) - s of times, in seconds."""
    return float(np.exp(np.log(np.asarray(times_s) + shift_s).mean()) - shift_s)


@dataclass(frozen=True, eq=False)
class Profile:
    """Performance profile of planners' times (Dolan and More, 2002)."""

    planners: tuple[str, ...]  # Names of the planners
    ratios: Floats  # (k,) sorted ratios to the best time of a task, at least 1
    # (planners, k) share of tasks solved by each planner within each ratio
    shares: Floats


def time_profile(rows: Sequence[Row], best: Mapping[Question, float]) -> Profile:
    """Return the performance profile of the planners' times of solved cases."""
    planners = tuple(dict.fromkeys(row.planner for row in rows))
    questions = {question: n for n, question in enumerate(dict.fromkeys(r.question for r in rows))}
    times_s = np.full((len(questions), len(planners)), np.nan)
    for row in rows:
        solved = is_solved(row, best)
        at = questions[row.question], planners.index(row.planner)
        times_s[at] = step_s(row) if solved else np.inf
    ratios, shares = performance_profile(times_s)
    return Profile(planners, ratios, shares)


def performance_profile(
    times_s: Floats,  # (q, s)
) -> tuple[Floats, Floats]:
    """Return time ratios (k,), and each solver's share (s, k) of tasks solved within them."""
    finite = np.where(np.isfinite(times_s), times_s, np.inf)
    fastest = finite.min(axis=1, keepdims=True) if finite.size else finite[:, :1]
    some = np.isfinite(fastest)
    # A zero time is the fastest; equal times have the ratio 1.
    least = np.where(some, np.maximum(fastest, np.finfo(float).tiny), 1.0)
    ratio = np.where(np.isfinite(finite), np.maximum(finite, least) / least, np.inf)
    ratios = np.unique(np.append(ratio[np.isfinite(ratio)], 1.0))
    timed = ~np.isnan(times_s)
    within = (ratio[:, :, None] <= ratios) & timed[:, :, None]
    counts = np.maximum(timed.sum(axis=0), 1)
    return ratios, within.sum(axis=0) / counts[:, None]
