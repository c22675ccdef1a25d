"""Simulate whatever a problem asks.

A problem that is to reach a goal has one robot and is answered by a Simulation. All others maximise
a sum of terms, with one robot or several, and are answered by a TeamRun.
"""

from __future__ import annotations

from collections.abc import Callable

from planopt.planning.given import GivenMeasurements, with_measurements
from planopt.planning.loop.closed_loop import simulate as simulate_reach
from planopt.planning.loop.simulation import Simulation
from planopt.planning.prepare import prepare
from planopt.planning.team.team_loop import simulate_team
from planopt.planning.team.team_run import TeamRun
from planopt.problems.overrides import with_overrides
from planopt.problems.problem import Problem


def simulate(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
    seed: int = 0,
    measurements: GivenMeasurements | None = None,
    on_step: Callable[[int], None] | None = None,
) -> Simulation | TeamRun:
    """Drive a problem's robots in the true channel.

    Parameters
    ----------
    problem
        The problem; it must have a truth.
    horizon, planner, cost_to_go
        Override the problem's planner settings; a cost to go only where there is a goal.
    seed
        Of everything that happens.
    measurements
        First measurements in place of those that the problem names: :class:`planopt.Measurements`
        or a table (dictionary or DataFrame) with ``x_m``, ``y_m`` and ``power_dbm``; of several
        stations a sequence with one for each.
    on_step
        Called after every step with its number, for progress display.

    Returns
    -------
    Simulation | TeamRun
        The first where the task is ``reach``.

    Raises
    ------
    InputError
        An override or a file that the problem names cannot be used, or there is no truth.
    NoPlanError
        Obstacles cut the goal off.
    """
    problem, given = with_measurements(problem, measurements)
    problem = with_overrides(problem, horizon=horizon, planner=planner, cost_to_go=cost_to_go)
    prepared = None if given is None else prepare(problem, seed, given)
    if problem.task == "reach":
        return simulate_reach(problem, seed=seed, prepared=prepared, on_step=on_step)
    return simulate_team(problem, seed=seed, prepared=prepared, on_step=on_step)
