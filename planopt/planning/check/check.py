"""Judge a saved plan or run again from its files alone, or read it back as an object.

Nothing the planner computed is taken for granted: places come from ``steps.csv``, the ground truth
from the problem and the seed, the channel is fitted and conditioned again on the saved
measurements, and the verifier decides. From that everything that the files say is computed again
and compared, key by key and cell by cell. A key that cannot be computed again, wall times for one,
must at least fit the others; a key that is not known is rejected.

Nothing in a file proves that its problem is the one that was meant: a file with another ``p_min``
asks another question. Its difference from the library's problem of that name is said; it is no
reason to reject.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from planopt.channel.one_thread import one_blas_thread
from planopt.errors import InputError, NoPlanError, path_of
from planopt.planning.certificate import Certificate, dearest, worst_result
from planopt.planning.check.agreement import disagreements, in_words, without_searched
from planopt.planning.check.check_belief import given_again, has_no_truth, learnt_again
from planopt.planning.check.check_plan import check_plan, no_way_faults, rebuilt_solution
from planopt.planning.check.check_plan import length_faults as plan_length_faults
from planopt.planning.check.check_run import check_run, length_faults, rebuilt_run
from planopt.planning.check.check_steps import label_reasons
from planopt.planning.files.read_saved import Saved, read_object, read_saved, saved_from
from planopt.planning.files.record import REMEDY
from planopt.planning.files.run_json import RunRecord, no_run_json
from planopt.planning.files.saved import FORMAT, PLAN_FILE
from planopt.planning.files.solution_json import (
    NoPlanRecord,
    PlanRecord,
    explanation_again,
    no_plan_json,
)
from planopt.planning.given import Given, with_drawn_starts
from planopt.planning.plan import Verdict
from planopt.planning.run import Run
from planopt.planning.solution import Solution
from planopt.planning.team.reservations import least_of
from planopt.problems.library import SUFFIX, library_folder
from planopt.problems.load import load
from planopt.problems.problem import Problem
from planopt.problems.save import problem_to_dict
from planopt.problems.systems import judge_saved
from planopt.short_repr import short_repr


def library_remarks(file: str, problem: Problem, seed: int = 0) -> list[str]:
    """Say how the problem in `file` differs from the library's; empty if it does not.

    `seed` is that of what was planned or run: starts are drawn with it.

    Horizon, planner and cost to go may be others: the file says beside the problem what they are.
    """
    original = library_folder() / f"{problem.name}{SUFFIX}"
    if not original.is_file():
        return [
            f"{file}, key problem_file.problem.name: {problem.name} is no problem of the library, "
            "it is taken as it stands"
        ]
    try:
        meant = _but_overrides(problem_to_dict(with_drawn_starts(load(original), seed)))
    except InputError as error:
        return [f"{file}, key problem_file: cannot be compared with the library's: {error}"]
    said = _but_overrides(problem_to_dict(problem))
    remarks: list[str] = []
    if has_no_truth(problem) and "truth" in meant["channel"]:
        remarks.append(
            f"{file}, key problem_file.channel: has no ground truth and no first measurements, as "
            f"where they are from Python; the library's {problem.name} has"
        )
        for tables in (said, meant):
            channel = {key: value for key, value in tables["channel"].items() if key != "truth"}
            measured = {k: v for k, v in channel["measurements"].items() if k != "count"}
            tables["channel"] = {**channel, "measurements": measured}
    return remarks + in_words(
        file,
        disagreements(said, meant, "problem_file"),
        f"in the library's {problem.name}",
    )


def _but_overrides(tables: dict[str, Any]) -> dict[str, Any]:
    """`tables` without what the command line may change."""
    without = {"planner": ("horizon", "name"), "objective": ("cost_to_go",)}
    return {
        table: {key: value for key, value in keys.items() if key not in without[table]}
        if table in without
        else keys
        for table, keys in tables.items()
    }


@dataclass(frozen=True)
class CheckResult:
    """The outcome of a check."""

    verdict: Verdict  # verified if there is nothing to object, else violated; none for no plan
    # What the verifier computed: one for a plan, one a step for a run
    certificates: tuple[Certificate, ...]
    reasons: tuple[str, ...]  # Every objection; empty if verified
    # What could not be judged, and how the problem differs from the library's of its name
    remarks: tuple[str, ...] = ()

    __repr__ = short_repr

    @property
    def certificate(self) -> Certificate | None:
        """The only one, or the worst of a run: its steps are those driven that miss the bound."""
        if len(self.certificates) <= 1:
            return self.certificates[0] if self.certificates else None
        return _worst(self.certificates)


@one_blas_thread()
def check(path: Path | str) -> CheckResult:
    """Judge a saved plan or run from its files.

    Parameters
    ----------
    path
        The folder, or its ``plan.json`` or ``run.json``.

    Raises
    ------
    InputError
        A file is missing, truncated or not what it should be; with file, key or row.
    """
    file, data = read_object(path_of("path", path, "give a folder: save a result before"))
    judged = judge_saved(file, data)
    if judged is not None:
        return CheckResult(Verdict.VIOLATED if judged else Verdict.VERIFIED, (), tuple(judged))
    saved = saved_from(file, data)
    problem, record, name = saved.problem, saved.record, saved.file.name
    remarks = library_remarks(name, problem, record.seed)
    if saved.former:
        remarks.append(
            f"{name} has the form of an earlier version, which the next version will not read"
        )
    if isinstance(record, NoPlanRecord):
        return CheckResult(Verdict.NONE, (), tuple(_no_plan_reasons(saved)), tuple(remarks))
    reasons = label_reasons(name, record)
    if reasons:
        return CheckResult(Verdict.VIOLATED, (), tuple(reasons), tuple(remarks))
    given, more = given_again(problem, record.seed)
    remarks += [*more, *_not_judged(saved, given)]
    if isinstance(record, PlanRecord):
        certificates, reasons = check_plan(saved, record, given)
    else:
        certificates, reasons = check_run(saved, record, given)
    verdict = Verdict.VIOLATED if reasons else Verdict.VERIFIED
    return CheckResult(verdict, tuple(certificates), tuple(reasons), tuple(remarks))


def _not_judged(saved: Saved, given: Given | None) -> list[str]:
    """Return what only planning again, or the ground truth, could tell."""
    remarks: list[str] = []
    problem = saved.problem
    if any(term.steers for term in problem.terms):
        remarks.append(
            "the ways that a term steers along (steering_m, steering_turns_m) are taken as they "
            "stand"
        )
    if given is None and isinstance(saved.record, RunRecord) and problem.task != "reach":
        remarks.append("knowledge.csv is taken as it stands, because there is no truth")
    if saved.former and isinstance(saved.record, RunRecord) and problem.task == "reach":
        remarks.append("costs are taken as they stand: that version charged steps by their ends")
    return remarks


def _no_plan_reasons(saved: Saved) -> list[str]:
    """Return that there is nothing to judge, and what the file says besides that is not so."""
    message, seed = str(saved.data["message"]), saved.record.seed
    found: dict[str, Any] = {"format": FORMAT, "problem_file": saved.data["problem_file"]}
    faults: list[str] = []
    if saved.file.name == PLAN_FILE and isinstance(saved.record, NoPlanRecord):
        explanation = explanation_again(saved.record.explanation)
        found |= no_plan_json(saved.problem, seed, message, explanation)
        faults = no_way_faults(saved.problem, explanation)
    else:
        found |= {**no_run_json(saved.problem, seed, message), "plans": []}
    said, meant = without_searched(saved.data), without_searched(found)
    return [
        f"there is no plan to judge: {message}",
        *in_words(saved.file.name, disagreements(said, meant)),
        *(f"{saved.file.name}, key {fault}" for fault in faults),
    ]


def _worst(certificates: Sequence[Certificate]) -> Certificate:
    """The worst of a run's certificates in each respect."""
    residuals = [c.kkt_residual for c in certificates if c.kkt_residual is not None]
    missed = [
        (step, certificate)
        for step, certificate in enumerate(certificates, start=1)
        if 1 in certificate.relaxed_steps
    ]
    return Certificate(
        min_clearance_m=min(c.min_clearance_m for c in certificates),
        min_connectivity=min(c.min_connectivity for c in certificates),
        dynamics_defect=max(c.dynamics_defect for c in certificates),
        kkt_residual=max(residuals, default=None),
        posterior=certificates[-1].posterior,
        relaxed_steps=tuple(step for step, _ in missed),
        relaxation_db=tuple(c.relaxation_db[0] for _, c in missed),
        best_margin_db=tuple(c.best_margin_db[0] for _, c in missed if c.best_margin_db),
        **dearest(certificates),
        reasons=tuple(reason for c in certificates for reason in c.reasons),
        min_separation_m=least_of(c.min_separation_m for c in certificates),
        min_moving_clearance_m=least_of(c.min_moving_clearance_m for c in certificates),
        rule=worst_result(c.rule for c in certificates),
    )


@one_blas_thread()
def load_result(path: Path | str) -> Solution | Run:
    """Read a saved plan or run, as :func:`planopt.load_result` does."""
    saved = read_saved(Path(path))
    record = saved.record
    if isinstance(record, NoPlanRecord):
        raise NoPlanError(record.message)
    faults = label_reasons(saved.file.name, record)
    is_plan = isinstance(record, PlanRecord)
    faults += plan_length_faults(saved) if is_plan else length_faults(saved, record)
    learnt, unfitted = learnt_again(saved.problem, saved.beliefs)
    if faults or unfitted:
        raise InputError([*faults, *unfitted][0], file=saved.file, remedy=REMEDY)
    if is_plan:
        return rebuilt_solution(saved, record, learnt[0])[0]
    given, _ = given_again(saved.problem, record.seed)
    return rebuilt_run(saved, record, learnt, () if given is None else given.truths).run
