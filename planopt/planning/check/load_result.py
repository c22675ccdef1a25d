"""Read a saved plan or run back as the object that it was."""

from __future__ import annotations

from pathlib import Path

from planopt.channel.one_thread import one_blas_thread
from planopt.errors import InputError, NoPlanError
from planopt.planning.check.check_belief import given_again, learnt_again
from planopt.planning.check.check_plan import length_faults as plan_length_faults
from planopt.planning.check.check_plan import rebuilt_solution
from planopt.planning.check.check_run import length_faults, rebuilt_run
from planopt.planning.check.check_steps import label_reasons
from planopt.planning.files.read_saved import read_saved
from planopt.planning.files.record import REMEDY
from planopt.planning.files.solution_json import NoPlanRecord, PlanRecord
from planopt.planning.run import Run
from planopt.planning.solution import Solution


@one_blas_thread()
def load_result(path: Path | str) -> Solution | Run:
    """Read a saved plan or run, as :func:`planopt.load_result` does.

    Raises
    ------
    InputError
        A file is missing, damaged, or contradicts the others.
    NoPlanError
        The folder says that there is no plan.
    """
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
