"""The closed loop: move, measure, update the belief, plan again, until the goal or a standstill."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief, update
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.truth import Truth, measure, true_power_dbm
from planopt.errors import InputError
from planopt.planning.metrics import metrics_of
from planopt.planning.plan import Plan, Rung, Verdict
from planopt.planning.prepare import Prepared, prepare
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.run import Outcome, Run, StepLog
from planopt.planning.scene import Scene, build_scene
from planopt.planning.simulation import Simulation
from planopt.planning.tolerances import STANDSTILL_M
from planopt.problems.overrides import with_overrides
from planopt.problems.problem import Problem

STALL_STEPS = 30
"""A robot that learns nothing new for this many steps and stays within two longest steps of one
place has stalled."""


@one_blas_thread()
def simulate(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
    seed: int = 0,
    scene: Scene | None = None,
    prepared: Prepared | None = None,
    on_step: Callable[[int], None] | None = None,
) -> Simulation:
    """Drive a problem's robot in the true channel.

    Parameters
    ----------
    problem
        The problem; it must have a truth.
    horizon, planner, cost_to_go
        Override the problem's planner settings.
    seed
        Of the truth's fading and of the first measurements.
    scene, prepared
        Geometry, truth and first belief if they are there already, for many runs of one seed.
    on_step
        Called after every step with its number, for progress display.
    """
    problem = with_overrides(problem, horizon=horizon, planner=planner, cost_to_go=cost_to_go)
    prepared = prepared if prepared is not None else prepare(problem, seed)
    if prepared.truth is None:
        raise InputError(
            "a simulation needs a truth to drive in", file=problem.file, key="channel.truth"
        )
    scene = scene if scene is not None else build_scene(problem)
    planning = ReachPlanner(problem, scene)
    belief, truth = prepared.belief, prepared.truth
    position = np.asarray(problem.robots[0].start_m)
    goal = np.asarray(problem.goal_m)
    track = [position]
    plans: list[Plan] = []
    since_learnt = 0
    outcome, reason = Outcome.STEP_LIMIT, f"not arrived after {problem.planner.max_steps} steps"
    if np.linalg.norm(position - goal) <= problem.constraints.goal_radius_m:
        outcome, reason = Outcome.REACHED, "the start is within goal_radius_m of the goal"
    while outcome is Outcome.STEP_LIMIT and len(plans) < problem.planner.max_steps:
        plan = planning.plan(belief, position, plans[-1] if plans else None)
        plans.append(plan)
        moved = plan.positions_m[1]
        stood = bool(np.linalg.norm(moved - position) <= STANDSTILL_M)
        position = moved
        track.append(position)
        before = len(belief.posterior.measurements)
        belief = _learn_here(problem, truth, belief, position)
        learnt = len(belief.posterior.measurements) > before
        since_learnt = 0 if learnt else since_learnt + 1
        if on_step is not None:
            on_step(len(plans))
        if np.linalg.norm(position - goal) <= problem.constraints.goal_radius_m:
            outcome, reason = Outcome.REACHED, "within goal_radius_m of the goal"
        elif stood and not learnt and plan.rung is not Rung.SHIFTED:
            # Same place, same belief: the next plan would be this one again.
            outcome, reason = Outcome.STALLED, _standing_reason(plan)
        elif since_learnt >= STALL_STEPS and _circling(track, problem.step_length_m):
            outcome = Outcome.STALLED
            reason = (
                f"within {2 * problem.step_length_m:g} m of one place for {STALL_STEPS} steps, "
                f"with nothing new to learn{_detail(plan)}"
            )
    log = _log(problem, truth, np.array(track), plans)
    run = Run(
        robot=problem.robots[0].name,
        horizon=problem.planner.horizon,
        planner=problem.planner.name,
        cost_to_go=problem.cost_to_go,
        seed=seed,
        outcome=outcome,
        reason=reason,
        log=log,
        metrics=metrics_of(log, plans, outcome),
    )
    first = len(prepared.belief.posterior.measurements)
    return Simulation(problem, seed, belief, first, run, tuple(plans), truth)


def _learn_here(
    problem: Problem, truth: Truth, belief: Belief, position_m: NDArray[np.float64]
) -> Belief:
    """Measure where the robot is, unless a place that near has been measured already."""
    known = belief.posterior.measurements.positions_m
    spacing = problem.channel.measure_spacing_m
    if len(known) and np.linalg.norm(known - position_m, axis=1).min() < spacing:
        return belief
    return update(belief, measure(truth, position_m[None]))


def _circling(track: list[NDArray[np.float64]], step_length_m: float) -> bool:
    if len(track) <= STALL_STEPS:
        return False
    recent = np.array(track[-STALL_STEPS - 1 :])
    return bool(np.linalg.norm(recent - recent[0], axis=1).max() <= 2.0 * step_length_m)


def _standing_reason(plan: Plan) -> str:
    return f"standing still with nothing new to learn{_detail(plan)}"


def _detail(plan: Plan) -> str:
    return f": {plan.message}" if plan.message else ""


def _log(problem: Problem, truth: Truth, track: NDArray[np.float64], plans: list[Plan]) -> StepLog:
    """Tabulate a run; row 0 is the start, as the first plan saw it."""
    power = true_power_dbm(truth, track)
    first = plans[:1]

    def column(at_start: float, values: list[float]) -> NDArray[np.float64]:
        return np.array([at_start, *values], dtype=float)

    relaxation = [
        dict(zip(p.certificate.relaxed_steps, p.certificate.relaxation_db, strict=True)).get(1, 0.0)
        for p in plans
    ]
    return StepLog(
        t_s=problem.planner.step_s * np.arange(len(track), dtype=np.float64),
        positions_m=track,
        predicted_dbm=column(
            first[0].mean_dbm[0] if first else np.nan, [p.mean_dbm[1] for p in plans]
        ),
        deviation_db=column(
            first[0].deviation_db[0] if first else np.nan, [p.deviation_db[1] for p in plans]
        ),
        connectivity=column(
            first[0].connectivity[0] if first else np.nan, [p.connectivity[1] for p in plans]
        ),
        true_dbm=power,
        connected=power >= problem.stations[0].threshold_dbm,
        step_s=column(0.0, [p.wall_s for p in plans]),
        polish_gain_s=column(0.0, [p.lattice_objective - p.objective for p in plans]),
        relaxation_db=column(0.0, relaxation),
        rung=(Rung.PLAN, *(p.rung for p in plans)),
        verdict=(Verdict.VERIFIED, *(p.verdict for p in plans)),
    )
