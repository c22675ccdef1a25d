"""Scenes of the benchmarks: munich_courier with any number of first measurements.

The channel parameters are those fitted to the problem's own 300 measurements, whatever the number
conditioned on: what is timed is planning, not fitting 5,000 measurements.
"""

from __future__ import annotations

from functools import cache
from time import perf_counter

import numpy as np

from planopt import Measurements, Plan, Problem, load
from planopt.channel import Belief, Truth, condition, measure
from planopt.channel.posterior import update
from planopt.planning.free_space import free_places
from planopt.planning.initial_data import Prepared, prepare
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import Scene, build_scene
from planopt.problems.load import with_overrides

PROBLEM = "munich_courier"
PLACES_SEED = 7
"""Of the measured places; another than the problem's own."""
MOST_MEASUREMENTS = 8192


@cache
def munich() -> tuple[Problem, Scene, Prepared]:
    """The problem, its geometry, and truth and belief of seed 0."""
    problem = load(PROBLEM)
    return problem, build_scene(problem), prepare(problem, 0)


def true_channel() -> Truth:
    """What is measured and driven in."""
    (truth,) = munich()[2].truths
    return truth


@cache
def sampled(count: int) -> Measurements:
    """`count` measurements of the truth; a longer sample begins with a shorter one."""
    places = free_places(munich()[0], MOST_MEASUREMENTS, np.random.default_rng(PLACES_SEED))
    return measure(true_channel(), places[:count])


@cache
def belief_from(count: int) -> Belief:
    """What `count` measurements tell under the fixed channel parameters."""
    fit = munich()[2].belief.fit
    return Belief(fit, condition(fit.parameters, sampled(count)))


class Drive:
    """A closed loop, one step at a time: `learn`, then `step`.

    The plan at the start, which fills the map from nothing, and a first step, which takes a copy of
    the shared belief's factor, are made here and are not timed.

    Parameters
    ----------
    count
        First measurements.
    horizon, cost_to_go
        Planner settings.
    """

    def __init__(self, count: int, horizon: int, cost_to_go: str) -> None:
        problem, scene, _ = munich()
        problem = with_overrides(problem, horizon=horizon, cost_to_go=cost_to_go)
        self._planner = ReachPlanner(problem, scene)
        self._belief = belief_from(count)
        self._plan = self._planner.plan(self._belief, np.asarray(problem.robots[0].start_m))
        self.update_s: list[float] = []
        self.step_s: list[float] = []
        self.learn()
        self.step()
        self.update_s.clear()
        self.step_s.clear()

    def learn(self) -> None:
        """Move, measure, and update the factor, which is no part of the step's time."""
        found = measure(true_channel(), self._plan.positions_m[1:2])
        begun = perf_counter()
        self._belief = update(self._belief, found)
        self.update_s.append(perf_counter() - begun)

    def step(self) -> Plan:
        """Map refresh after the new measurement, cost to go, lattice, polish, verification."""
        begun = perf_counter()
        self._plan = self._planner.plan(self._belief, self._plan.positions_m[1], self._plan)
        self.step_s.append(perf_counter() - begun)
        return self._plan
