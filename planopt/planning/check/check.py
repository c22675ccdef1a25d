"""Verification of a saved plan or run from its files alone, and loading of results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from planopt.channel.cholesky import one_blas_thread
from planopt.errors import InputError, NoPlanError
from planopt.files.compare import DIGEST, differences, digest, in_words
from planopt.files.tables import REMEDY
from planopt.planning.certificate import Certificate, worst_of, worst_of_robots
from planopt.planning.check.replay import belief_reasons, plan_reasons, replayed, start_of
from planopt.planning.files.result_json import NoPlanRecord, RunRecord, no_plan_json, no_run_json
from planopt.planning.files.saved import FORMAT, PLAN_FILE, Saved, contents, saved_from
from planopt.planning.free_space import with_drawn_starts
from planopt.planning.loop.results import Run, Solution
from planopt.planning.plan import Plan, Verdict
from planopt.problems.library import SUFFIX, library_folder
from planopt.problems.load import load_motion, problem_to_dict
from planopt.problems.problem import Problem, problem_at, problem_of_robot
from planopt.problems.results import Contents
from planopt.short_repr import short_repr


def library_remarks(file: str, problem: Problem, seed: int = 0) -> list[str]:
    """Return the differences between a saved problem and the library's problem of that name."""
    # Horizon, planner and cost-to-go are not compared because the file stores them separately.
    original = library_folder() / f"{problem.name}{SUFFIX}"
    if not original.is_file():
        return [
            f"{file}, key problem_file.problem.name: {problem.name} is not in the library, so that "
            "it is not compared"
        ]
    try:
        meant = _but_overrides(problem_to_dict(with_drawn_starts(load_motion(original), seed)))
    except InputError as error:
        return [f"{file}, key problem_file: cannot be compared with the library's: {error}"]
    saved_data = _but_overrides(problem_to_dict(problem))
    remarks: list[str] = []
    if problem.channel.truth is None and "truth" in meant["channel"]:
        remarks.append(
            f"{file}, key problem_file.channel: has no ground truth and no first measurements, as "
            f"where they are from Python; the library's {problem.name} has"
        )
        for tables in (saved_data, meant):
            channel = {key: value for key, value in tables["channel"].items() if key != "truth"}
            measured = {k: v for k, v in channel["measurements"].items() if k != "count"}
            tables["channel"] = {**channel, "measurements": measured}
    found = differences(saved_data, meant, "problem_file", accepted=frozenset())
    return remarks + in_words(file, found, f"in the library's {problem.name}")


def _but_overrides(tables: dict[str, Any]) -> dict[str, Any]:
    """Return a problem's tables without settings that the command line can override."""
    without = {"planner": ("horizon", "name"), "objective": ("cost_to_go",)}
    return {
        table: {key: value for key, value in keys.items() if key not in without[table]}
        if table in without
        else keys
        for table, keys in tables.items()
    }


@dataclass(frozen=True)
class CheckResult:
    """Result of checking a saved plan or run."""

    verdict: Verdict  # ``verified`` or ``violated``; ``none`` if there is no plan
    # Certificates of the repeated verification: one for a plan, one per step of a run
    certificates: tuple[Certificate, ...]
    reasons: tuple[str, ...]  # All objections; empty if verified
    # Notes: parts that could not be checked, differences from the library's problem of that name
    remarks: tuple[str, ...] = ()

    __repr__ = short_repr

    @property
    def certificate(self) -> Certificate | None:
        """Return the certificate of a plan, or the worst values of a run."""
        if len(self.certificates) <= 1:
            return self.certificates[0] if self.certificates else None
        return _worst(self.certificates)


@one_blas_thread()
def check_motion(file: Path, data: Mapping[str, Any]) -> CheckResult:
    """Return the result of checking a saved plan or run, from its loaded JSON object."""
    saved = saved_from(file, data)
    name = saved.file.name
    remarks = library_remarks(name, saved.problem, saved.record.seed)
    if isinstance(saved.record, NoPlanRecord):
        return CheckResult(Verdict.NONE, (), tuple(_no_plan_reasons(saved)), tuple(remarks))
    made: tuple[tuple[Plan, ...], ...] = ()
    try:
        start, found = start_of(saved)
    except InputError as error:
        reasons = [f"{saved.beliefs[0].file.name}: the channel cannot be fitted again: {error}"]
    else:
        remarks += found
        result = replayed(saved, start)
        made = (
            tuple(zip(*result.plans, strict=True)) if isinstance(result, Run) else (result.plans,)
        )
        reasons = [*_objections(saved, result), *_different(saved, contents(result))]
    verdict = Verdict.VIOLATED if reasons else Verdict.VERIFIED
    certificates = tuple(
        worst_of_robots({plan.robot: plan.certificate for plan in plans}) for plans in made
    )
    return CheckResult(verdict, certificates, tuple(reasons), tuple(remarks))


def _objections(saved: Saved, result: Solution | Run) -> list[str]:
    """Return the verifier's reasons to reject plans of a replayed result."""
    if isinstance(result, Solution):
        return [
            f"{plan.robot}: {reason}" if len(result.plans) > 1 else reason
            for number, plan in enumerate(result.plans)
            for reason in plan_reasons(problem_of_robot(saved.problem, number), plan)
        ]
    reasons: list[str] = []
    for number, plans in enumerate(result.plans):
        for step, plan in enumerate(plans):
            own = problem_of_robot(problem_at(saved.problem, step), number)
            where = f"plans[{number}].released[{step}], the plan for step {step + 1}"
            reasons += [
                f"{saved.file.name}, key {where}: {reason}" for reason in plan_reasons(own, plan)
            ]
    if len(result.plans[0]) < len(saved.plans[0]):
        late = f"the run goes on after step {len(result.plans[0])}, {result.reason}"
        reasons.append(f"{saved.file.name}, key plans: {late}")
    return reasons


def _different(saved: Saved, found: Contents) -> list[str]:
    """Return the differences between the saved files and the replayed result."""
    # The problem is excluded because library_remarks compares it.
    data = {**found.data, DIGEST: digest(saved.data), "problem_file": saved.data["problem_file"]}
    reasons = in_words(found.file, differences(saved.data, data))
    reasons += found.table_reasons(saved.tables)
    for belief in saved.beliefs:
        reasons += belief_reasons(belief, found.arrays[belief.file.name], saved.record.seed)
    return reasons


def _no_plan_reasons(saved: Saved) -> list[str]:
    """Return differences between a saved result without a plan and the recomputed one."""
    message, record = str(saved.data["message"]), saved.record
    found: dict[str, Any]
    if saved.file.name == PLAN_FILE and isinstance(record, NoPlanRecord):
        found = no_plan_json(saved.problem, record.seed, message, record.explanation)
    else:
        found = {**no_run_json(saved.problem, record.seed, message), "plans": []}
    found |= {"format": FORMAT, DIGEST: digest(saved.data)}
    found |= {key: saved.data[key] for key in ("problem_file", "blocked") if key in saved.data}
    words = in_words(saved.file.name, differences(saved.data, found))
    return [f"there is no plan to verify: {message}", *words]


def _worst(certificates: Sequence[Certificate]) -> Certificate:
    """Return a certificate with the worst values over a run."""
    missed = [
        (step, certificate)
        for step, certificate in enumerate(certificates, start=1)
        if 1 in certificate.relaxed_steps
    ]
    return replace(
        worst_of(certificates),
        posterior=certificates[-1].posterior,
        relaxed_steps=tuple(step for step, _ in missed),
        relaxation_db=tuple(c.relaxation_db[0] for _, c in missed),
        best_margin_db=tuple(c.best_margin_db[0] for _, c in missed if c.best_margin_db),
    )


@one_blas_thread()
def load_motion_result(file: Path, data: Mapping[str, Any]) -> Solution | Run:
    """Return a saved plan or run, as :func:`planopt.load_result` does."""
    saved = saved_from(file, data)
    if isinstance(saved.record, NoPlanRecord):
        raise NoPlanError(saved.record.message)
    result, record = replayed(saved, start_of(saved)[0]), saved.record
    if isinstance(result, Run) and isinstance(record, RunRecord):
        if (result.outcome.value, result.reason) != (record.outcome, record.message):
            ends = f"'{record.outcome} ({record.message})' differs from the recomputed "
            ends += f"'{result.outcome.value} ({result.reason})'"
            raise InputError(ends, file=saved.file, key="outcome", remedy=REMEDY)
    return result
