"""Public functions of ``planopt`` that accept problems of any task."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from planopt.errors import InputError, NoPlanError, path_of
from planopt.planning.check.check import CheckResult
from planopt.planning.files.saved import read_object
from planopt.planning.initial_data import UserMeasurements
from planopt.planning.plan import Plan, Verdict
from planopt.problems.problem import Problem
from planopt.problems.tasks import TaskProblem, named_task, task_named
from planopt.tasks.task import Task, TaskResult, perform

if TYPE_CHECKING:
    from planopt.planning.loop.results import Run, Solution
    from planopt.studies.comparison import Comparison


@overload
def solve(
    problem: TaskProblem,
    *,
    horizon: int | None = ...,
    planner: str | None = ...,
    seed: int = ...,
    prove_s: float | None = ...,
) -> TaskResult: ...
@overload
def solve(
    problem: Problem,
    *,
    horizon: int | None = ...,
    planner: str | None = ...,
    cost_to_go: str | None = ...,
    seed: int = ...,
    measurements: UserMeasurements | None = ...,
    prove_s: float | None = ...,
) -> Solution: ...
def solve(
    problem: Problem | TaskProblem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
    seed: int = 0,
    measurements: UserMeasurements | None = None,
    prove_s: float | None = None,
) -> Solution | TaskResult:
    """Plan once from the initial state: `horizon` steps per robot, or a design or deployment.

    The steps are equal to those of a simulation's first plans with the same seed. Routes to a goal
    are smoothed, and `objective` has their cost; a simulation plans again after each step instead.

    Parameters
    ----------
    problem
        A problem from :func:`planopt.load` or built in Python.
    horizon, planner, cost_to_go
        Overrides of the planner settings. Only problems with a goal have a cost-to-go.
    seed
        Seed of the simulated fading, the positions of the initial measurements, the initial
        estimate of a target, and randomised planners.
    measurements
        Initial measurements that replace the problem's own: :class:`planopt.Measurements` or a
        table (dictionary or DataFrame) with ``x_m``, ``y_m`` in metres and ``power_dbm``; for
        several stations a sequence with one entry per station.
    prove_s
        Wall time in seconds, at most 1e6, for a proven bound on the objective of each plan, shared
        by the robots (:class:`planopt.extend.Bound`); None without proof. For deployments,
        processor time; 1 s by default.

    Returns
    -------
    Solution or TaskResult
        :class:`planopt.Solution` for motion planning, else a :class:`planopt.extend.TaskResult`.

    Raises
    ------
    InputError
        The task has no plans or no such setting, or a setting or file is invalid.
    NoPlanError
        No plan exists, for instance because obstacles block the goal.

    Examples
    --------
    >>> import planopt
    >>> solution = planopt.solve(planopt.load("open_field"), horizon=5)
    >>> solution.verdict.value, solution.plan.positions_m.shape
    ('verified', (6, 2))
    """
    return perform(
        "solve",
        problem,
        seed=seed,
        horizon=horizon,
        planner=planner,
        cost_to_go=cost_to_go,
        measurements=measurements,
        prove_s=prove_s,
    )


@overload
def simulate(
    problem: TaskProblem,
    *,
    horizon: int | None = ...,
    planner: str | None = ...,
    seed: int = ...,
    on_step: Callable[[int], None] | None = ...,
) -> TaskResult: ...
@overload
def simulate(
    problem: Problem,
    *,
    horizon: int | None = ...,
    planner: str | None = ...,
    cost_to_go: str | None = ...,
    seed: int = ...,
    measurements: UserMeasurements | None = ...,
    on_start: Callable[[Sequence[Plan]], None] | None = ...,
    on_plans: Callable[[int, Sequence[Plan]], None] | None = ...,
    on_step: Callable[[int], None] | None = ...,
) -> Run: ...
def simulate(
    problem: Problem | TaskProblem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
    seed: int = 0,
    measurements: UserMeasurements | None = None,
    on_start: Callable[[Sequence[Plan]], None] | None = None,
    on_plans: Callable[[int, Sequence[Plan]], None] | None = None,
    on_step: Callable[[int], None] | None = None,
) -> Run | TaskResult:
    """Simulate the closed loop: plan, move, measure in the simulated channel, update the belief.

    Parameters
    ----------
    problem
        Problem to simulate. Motion planning needs a ground truth, ``channel.truth``.
    horizon, planner, cost_to_go, measurements
        Parameters of :func:`planopt.solve`.
    seed
        Seed of the whole simulation.
    on_start
        Callback with the first plan of each robot before the first step; motion planning only.
    on_plans
        Callback with the number and the plans of each step, before it is driven; motion planning
        only.
    on_step
        Callback after every step with its number, for progress display.

    Returns
    -------
    Run or TaskResult
        :class:`planopt.Run` for motion planning, else a :class:`planopt.extend.TaskResult`.

    Raises
    ------
    InputError
        The task has no runs or no such setting, a setting or file is invalid, or there is no ground
        truth.
    NoPlanError
        No plan exists, for instance because obstacles block the goal.

    Examples
    --------
    >>> import planopt
    >>> run = planopt.simulate(planopt.load("open_field"), horizon=5, seed=1)
    >>> run.outcome.value, run.verified_rate
    ('reached', 1.0)
    """
    return perform(
        "simulate",
        problem,
        seed=seed,
        on_step=on_step,
        horizon=horizon,
        planner=planner,
        cost_to_go=cost_to_go,
        measurements=measurements,
        on_start=on_start,
        on_plans=on_plans,
    )


def check(path: Path | str) -> CheckResult:
    """Recompute a saved result from its files, verify it, and compare all values.

    Parameters
    ----------
    path
        Folder of the result, or its ``plan.json``, ``run.json`` or ``comparison.json``.

    Raises
    ------
    InputError
        A file is missing, truncated or invalid; the error names file, key or row.
    """
    from planopt.studies.comparison import comparison_reasons

    given = path_of("path", path, "give the folder of a saved result")
    try:
        reasons = comparison_reasons(given)
    except NoPlanError as error:
        return CheckResult(Verdict.NONE, (), (f"there is no comparison to check: {error}",))
    if reasons is None:
        file, data = read_object(given)
        return _task_of_file(file, data).check(file, data)
    return CheckResult(Verdict.VIOLATED if reasons else Verdict.VERIFIED, (), tuple(reasons))


def load_result(path: Path | str) -> Solution | Run | Comparison | TaskResult:
    """Read a plan, run or comparison that was saved by a command or a result's ``save``.

    Predictions, certificates, metrics and tables of motion planning are recomputed from the files.
    :func:`planopt.check` finds contradictions between the files of a plan or run.

    Parameters
    ----------
    path
        Folder of the result, or its ``plan.json``, ``run.json`` or ``comparison.json``.

    Returns
    -------
    Solution | Run | Comparison | TaskResult
        Result of the type that was saved. Constraint multipliers, and wall times and iterations of
        the plans of a run, are not saved; they are empty or zero.

    Raises
    ------
    InputError
        A file is missing, damaged or inconsistent with the others.
    NoPlanError
        The saved result states that no plan exists.

    Examples
    --------
    >>> import planopt, tempfile
    >>> solution = planopt.solve(planopt.load("open_field"), horizon=2)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     solution.save(folder)
    ...     planopt.load_result(folder).plan.objective == solution.plan.objective
    True
    """
    from planopt.studies.comparison import load_comparison

    given = path_of("path", path, "give the folder of a saved result")
    comparison = load_comparison(given)
    if comparison is not None:
        return comparison
    file, data = read_object(given)
    return _task_of_file(file, data).load_result(file, data)


def _task_of_file(file: Path, data: Mapping[str, Any]) -> Task:
    """Return the task of a saved result; raise an error that names the file if it has none."""
    try:
        return task_named(named_task(data.get("problem_file")))
    except InputError as error:
        raise error.located(file) from None
