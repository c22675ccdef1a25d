"""Scenes of the benchmarks: munich_courier with any number of first measurements.

The channel parameters are those fitted to the problem's own 300 measurements, whatever the number
conditioned on: what is timed is planning, not fitting 5,000 measurements.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from time import perf_counter

import numpy as np

from planopt.channel.belief import Belief, update
from planopt.channel.measurements import Measurements
from planopt.channel.posterior import condition
from planopt.channel.truth import Truth, measure
from planopt.planning.plan import Plan
from planopt.planning.prepare import Prepared, free_places, prepare
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import Scene, build_scene
from planopt.problems.load import load
from planopt.problems.overrides import with_overrides
from planopt.problems.problem import Problem

PROBLEM = "munich_courier"
PLACES_SEED = 7
"""Of the measured places; independent of the problem's own."""


@dataclass(frozen=True)
class Step:
    """One timed step of a closed loop.

    Attributes
    ----------
    update_s
        Wall time of the factor's update by one measurement.
    plan
        The plan; its ``wall_s`` is the step: map refresh, cost to go, lattice, polish, proof.
    """

    update_s: float
    plan: Plan


@cache
def munich() -> tuple[Problem, Scene, Prepared]:
    """The problem, its geometry, and truth and fit of seed 0."""
    problem = load(PROBLEM)
    return problem, build_scene(problem), prepare(problem, 0)


def truth() -> Truth:
    """What is driven in."""
    drawn = munich()[2].truth
    if drawn is None:
        raise AssertionError("the problem has a truth")
    return drawn


@cache
def sampled(count: int) -> Measurements:
    """`count` measurements of the truth; a longer sample begins with a shorter one."""
    problem = munich()[0]
    places = free_places(problem, 8192, np.random.default_rng(PLACES_SEED))
    return measure(truth(), places[:count])


@cache
def belief_from(count: int) -> Belief:
    """What `count` measurements tell under the fixed channel parameters."""
    fit = munich()[2].belief.fit
    return Belief(fit, condition(fit.parameters, sampled(count)))


def steps(count: int, horizon: int, cost_to_go: str, number: int) -> Iterator[Step]:
    """Drive and time `number` steps from the start, on `count` first measurements.

    The plan at the start, which fills the map, is made before and not among them; each step then
    adds the one measurement of where the robot is.
    """
    problem, scene, _ = munich()
    problem = with_overrides(problem, horizon=horizon, cost_to_go=cost_to_go)
    planner = ReachPlanner(problem, scene)
    belief = belief_from(count)
    plan = planner.plan(belief, np.asarray(problem.robots[0].start_m))
    for _ in range(number):
        position = plan.positions_m[1]
        begun = perf_counter()
        belief = update(belief, measure(truth(), position[None]))
        update_s = perf_counter() - begun
        plan = planner.plan(belief, position, plan)
        yield Step(update_s, plan)


def with_horizon(horizon: int, cost_to_go: str) -> Problem:
    """The problem with its planner settings changed."""
    return with_overrides(replace(munich()[0]), horizon=horizon, cost_to_go=cost_to_go)
