"""The closed loop: move, measure, update the belief, plan again, until the goal or a standstill."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planopt.channel.one_thread import one_blas_thread
from planopt.errors import InputError, NoPlanError
from planopt.planning.history import history_of
from planopt.planning.loop.clairvoyant import run_costs
from planopt.planning.loop.driven import driven
from planopt.planning.loop.ending import ending
from planopt.planning.loop.learning import learn_here
from planopt.planning.loop.metrics import metrics_of
from planopt.planning.loop.rule_metrics import rule_metrics
from planopt.planning.loop.run import Outcome, Run
from planopt.planning.loop.simulation import Simulation
from planopt.planning.loop.step_log import step_log
from planopt.planning.loop.true_serving import true_serving_dbm
from planopt.planning.plan import Plan
from planopt.planning.prepare import Prepared, prepare
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import Scene, build_scene
from planopt.problems.overrides import with_overrides
from planopt.problems.problem import Problem


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
    on_start: Callable[[Plan], None] | None = None,
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
    on_start
        Called with the first plan, before the first step.
    on_step
        Called after every step with its number, for progress display.
    """
    problem = with_overrides(problem, horizon=horizon, planner=planner, cost_to_go=cost_to_go)
    prepared = prepared if prepared is not None else prepare(problem, seed)
    if not prepared.truths:
        raise InputError(
            "a simulation needs a truth to drive in", file=problem.file, key="channel.truth"
        )
    scene = scene if scene is not None else build_scene(problem)
    planning = ReachPlanner(problem, scene)
    belief, truths = prepared.belief, prepared.truths
    state = problem.robots[0].start_state
    track = [state]
    plans: list[Plan] = []
    learnt: list[bool] = []
    ended = ending(problem, track, learnt, None)
    while ended is None:
        places = np.array(track)[:, :2]
        here = true_serving_dbm(problem, truths, places[1:])
        connected = here >= problem.stations[0].threshold_dbm
        proofs = [plan.certificate for plan in plans]
        history = history_of(problem, places, connected, proofs)
        try:
            plan = planning.plan(belief, state, plans[-1] if plans else None, history)
        except NoPlanError as error:
            ended = Outcome.NO_PLAN, str(error)
            break
        if not plans and on_start is not None:
            on_start(plan)
        plans.append(plan)
        state = plan.next_state
        track.append(state)
        before = len(belief.posterior.measurements)
        belief = learn_here(problem, truths, belief, state[:2])
        learnt.append(len(belief.posterior.measurements) > before)
        if on_step is not None:
            on_step(len(plans))
        ended = ending(problem, track, learnt, plan)
    outcome, reason = ended
    places = np.array(track)[:, :2]
    log = step_log(problem, places, true_serving_dbm(problem, truths, places), plans)
    run = Run(
        robot=problem.robots[0].name,
        horizon=problem.planner.horizon,
        planner=problem.planner.name,
        cost_to_go=problem.cost_to_go,
        seed=seed,
        outcome=outcome,
        reason=reason,
        log=log,
        metrics=metrics_of(log, plans, outcome, learnt),
        rule=rule_metrics(problem, [log]),
        drive=driven(problem.robots[0], plans),
        costs=run_costs(problem, scene.road_map, scene.index, truths, places, outcome),
    )
    first = len(prepared.belief.posterior.measurements)
    return Simulation(problem, seed, belief, first, run, tuple(plans), truths[0], truths[1:])
