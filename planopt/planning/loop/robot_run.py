"""Each robot's part of a run, from the plans that were driven and the ground truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connectivity_law import serving_power_dbm
from planopt.channel.ground_truth import Truth, true_power_dbm
from planopt.planning.loop.log import Outcome, RobotRun, StepLog
from planopt.planning.loop.metrics import metrics_of
from planopt.planning.plan import Plan, Rung, Verdict
from planopt.planning.proof.motion import is_at_goal, stands
from planopt.problems.problem import Problem
from planopt.problems.robot import Robot
from planopt.robots.drive import Drive


def true_serving_dbm(
    problem: Problem, truths: Sequence[Truth], positions_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The serving station's true power at places (n, 2), for the first one's threshold; ``(n,)``.

    The power itself of a single station
    (:mod:`planopt.channel.connectivity_law`). A robot is connected where it is at least
    ``problem.stations[0].true_threshold_dbm``.
    """
    powers = np.stack([true_power_dbm(truth, positions_m) for truth in truths])
    return serving_power_dbm(powers, [radio.true_threshold_dbm for radio in problem.stations])


def step_log(
    problem: Problem,
    track_m: NDArray[np.float64],  # (steps + 1, 2) where the robot was, the start first
    true_dbm: NDArray[np.float64],  # (steps + 1,) the true power there
    plans: Sequence[Plan],
) -> StepLog:
    """Tabulate a run; row 0 is the start, as the first plan saw it."""
    first = plans[:1]

    def column(at_start: float, values: list[float]) -> NDArray[np.float64]:
        return np.array([at_start, *values], dtype=float)

    relaxation = [
        dict(zip(p.certificate.relaxed_steps, p.certificate.relaxation_db, strict=True)).get(1, 0.0)
        for p in plans
    ]
    return StepLog(
        t_s=problem.planner.step_s * np.arange(len(track_m), dtype=np.float64),
        positions_m=track_m,
        predicted_dbm=column(
            first[0].mean_dbm[0] if first else np.nan, [p.mean_dbm[1] for p in plans]
        ),
        deviation_db=column(
            first[0].deviation_db[0] if first else np.nan, [p.deviation_db[1] for p in plans]
        ),
        connectivity=column(
            first[0].connectivity[0] if first else np.nan, [p.connectivity[1] for p in plans]
        ),
        true_dbm=true_dbm,
        connected=true_dbm >= problem.stations[0].true_threshold_dbm,
        step_s=column(0.0, [p.wall_s for p in plans]),
        polish_gain_s=column(0.0, [p.gain for p in plans]),
        relaxation_db=column(0.0, relaxation),
        rung=(Rung.PLAN, *(p.rung for p in plans)),
        verdict=(Verdict.VERIFIED, *(p.verdict for p in plans)),
    )


def driven(robot: Robot, plans: Sequence[Plan]) -> Drive | None:
    """States and inputs of a run, the first step of each plan; None for the single integrator.

    A run of no step has the state that it starts in.
    """
    if robot.moves_freely:
        return None
    dynamics = robot.dynamics
    if not plans:
        return Drive(dynamics, robot.start_state[None], np.zeros((0, len(dynamics.input_names))))
    drives = [plan.drive for plan in plans if plan.drive is not None]
    if len(drives) < len(plans):
        return None
    states = [drives[0].states[0], *(drive.states[1] for drive in drives)]
    return Drive(drives[0].dynamics, np.array(states), np.array([d.inputs[0] for d in drives]))


def robot_run(
    problem: Problem,
    track_m: NDArray[np.float64],
    true_dbm: NDArray[np.float64],
    plans: Sequence[Plan],
    learnt: Sequence[bool],
    ended: tuple[Outcome, str],
) -> RobotRun:
    """Return one robot's part of a run, from its track and the plans that led along it."""
    # Shapes: track_m, true_dbm (steps + 1, 2).
    log = step_log(problem, track_m, true_dbm, plans)
    drive = driven(problem.robots[0], plans)
    reached = ended[0] is Outcome.REACHED and problem.robots[0].goal_m is not None
    arrival = _arrival(problem, track_m if drive is None else drive.states) if reached else None
    return RobotRun(
        robot=problem.robots[0].name,
        outcome=ended[0],
        reason=ended[1],
        log=log,
        metrics=metrics_of(log, plans, learnt, arrival),
        drive=drive,
    )


def _arrival(problem: Problem, states: NDArray[np.float64]) -> int:
    """Return the step after which a robot stands at its goal, from then on."""
    away = [not (is_at_goal(problem, state[:2]) and stands(problem, state)) for state in states]
    return int(np.flatnonzero(away).max(initial=-1)) + 1
