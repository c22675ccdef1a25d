"""The small problem of terms with a robot that cannot turn or stop at will."""

from dataclasses import replace
from typing import Any

import numpy as np
from terms_scene import context_of, scorer_of, terms_problem

from planopt import Problem
from planopt.extend import Dynamics
from planopt.planning.candidates import Scorer
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.problems import DoubleIntegrator, Unicycle

DOUBLE = DoubleIntegrator(2.0, 0.8)
WHEELS = Unicycle(2.0, 0.9)


def with_dynamics(problem: Problem, dynamics: Dynamics, *rest: float) -> Problem:
    """`problem` with these dynamics for each robot; `rest` is of the state at the start."""
    beyond = rest or (0.0,) * (len(dynamics.state_names) - 2)
    robots = tuple(
        replace(robot, dynamics=dynamics, start_rest=beyond, speed_max_m_s=dynamics.speed_max_m_s)
        for robot in problem.robots
    )
    return replace(problem, robots=robots)


def planned(problem: Problem, warm: Any = None, state: Any = None, seed: int = 0):
    """A plan from the problem's start, or from `state`, with its context, scorer and planner."""
    situation, belief = context_of(problem, seed)
    here = problem.robots[0].start_state if state is None else np.asarray(state)
    situation = replace(situation, state=here)
    scorer, ground = scorer_of(situation, belief)
    scorer = at_state(scorer, here)
    planner = HorizonPlanner(problem, ground)
    return planner.plan(situation, scorer, warm), situation, scorer, planner


def at_state(scorer: Scorer, state: np.ndarray) -> Scorer:
    """A scorer of a robot in another state."""
    return replace(scorer, context=replace(scorer.context, state=state))


def driven_problem(dynamics: Dynamics, *terms: dict[str, Any], **planner: Any) -> Problem:
    """The small problem of these terms with these dynamics."""
    return with_dynamics(terms_problem(*terms, **planner), dynamics)
