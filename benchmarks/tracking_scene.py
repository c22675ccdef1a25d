"""Scenes of tracking: a 100 m square with eight convex obstacles and an evader in it.

The channel is drawn from the model itself, and its parameters are taken as known, so that what is
timed and compared is planning, not fitting.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt import Plan, Problem
from planopt.channel import Belief, ChannelParameters, Truth, condition, measure
from planopt.channel.kriging import bound_margin_db
from planopt.channel.posterior import update
from planopt.objectives.moments import Region
from planopt.planning.candidates import Scorer
from planopt.planning.free_space import free_places
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.initial_data import draw_truth, learn
from planopt.planning.proof.rule import search_power, verifier_context
from planopt.planning.scene import Ground, build_ground
from planopt.planning.values.context import Aim, StepContext, step_context, workspace_region
from planopt.planning.values.objective_value import ObjectiveValue
from planopt.problems.problem import problem_from_tables

SIDE_M = 100.0
STEP_M = 2.0
EVADER_STEP_M = 1.5
EVADER_TURN_RAD = 0.2
P_MIN = 0.8
FITTED = 100
"""Measurements that the fit in a belief is from; planning does not look at it."""
FIELD_C = {"shadow_std_db": 4.0, "decorrelation_m": 20.0, "multipath_std_db": 1.13}
MUNICH_LIKE = {"shadow_std_db": 9.0, "decorrelation_m": 70.0, "multipath_std_db": 4.0}
CENTRES_M = ((30, 30), (60, 72), (72, 40), (38, 62), (20, 80), (80, 80), (55, 20), (15, 50))


@dataclass(frozen=True, eq=False)
class Scene:
    """One seeded scene: its problem, geometry, truth, and what is believed of the channel."""

    problem: Problem
    ground: Ground
    truth: Truth
    belief: Belief
    region: Region


def tracking_problem(horizon: int, seed: int = 0, **channel: float) -> Problem:
    """The problem of a seed: its obstacles, and field C unless `channel` says otherwise."""
    generator = np.random.default_rng(seed)
    obstacles: list[dict[str, Any]] = []
    for number, centre in enumerate(CENTRES_M):
        corners = 4 + number % 3
        angle = generator.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * np.arange(corners) / corners
        radius = generator.uniform(3.0, 7.0)
        ring = np.asarray(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle)])
        obstacles.append({"polygon": ring.tolist()})
    tables: dict[str, Any] = {
        "problem": {"schema": 1, "name": "evader", "task": "track"},
        "world": {"bounds_m": [0.0, 0.0, SIDE_M, SIDE_M], "obstacles": obstacles},
        "channel": {
            "truth": {"kind": "model", "k_pl_db": -10.0, "n_pl": 2.0, "cell_m": 0.5}
            | FIELD_C
            | channel,
            "measurements": {"count": FITTED, "spacing_m": 0.1},
            "fit": {"method": "nls"},
        },
        "robots": [{"start_m": _start_m(obstacles, generator), "speed_max_m_s": STEP_M}],
        "stations": [
            {
                "position_m": [0.5 * SIDE_M, 0.5 * SIDE_M],
                "height_m": 0.0,
                "transmit_power_dbm": 0.0,
                "threshold_dbm": -40.0,
            }
        ],
        "targets": [{"start_m": [1.0, 1.0], "velocity_m_s": [EVADER_STEP_M, 0.0]}],
        "objective": {
            "terms": [
                {
                    "kind": "tracking",
                    "form": "additive",
                    "noise_curvature": 0.008,
                    "noise_floor_m2": 0.08,
                    "sweet_spot_m": 1.0,
                }
            ]
        },
        "constraints": {"clearance_m": 0.1, "p_min": P_MIN},
        "planner": {"step_s": 1.0, "horizon": horizon, "max_steps": 100},
    }
    return problem_from_tables(tables, folder=Path(), file=None)


def _start_m(obstacles: list[dict[str, Any]], generator: np.random.Generator) -> list[float]:
    """A place some metres from every obstacle's centre, 8 to 20 m from the station."""
    centres = np.array(CENTRES_M, dtype=float)
    while True:
        angle, radius = generator.uniform(0.0, 2.0 * np.pi), generator.uniform(8.0, 20.0)
        place = 0.5 * SIDE_M + radius * np.array([np.cos(angle), np.sin(angle)])
        if np.linalg.norm(centres - place, axis=1).min() > 7.5:
            return [float(v) for v in place]


@cache
def scene(horizon: int, count: int, seed: int = 0, munich_like: bool = False) -> Scene:
    """A scene whose robot knows `count` measurements at random places."""
    problem = tracking_problem(horizon, seed, **(MUNICH_LIKE if munich_like else {}))
    fading, places = np.random.SeedSequence(seed).spawn(2)
    truth = draw_truth(problem, np.random.default_rng(fading))
    if truth is None:
        raise AssertionError("the problem has a truth")
    measured = measure(truth, free_places(problem, count, np.random.default_rng(places)))
    law = MUNICH_LIKE if munich_like else FIELD_C
    parameters = ChannelParameters(-10.0, 2.0, station=problem.stations[0].site, **law)
    belief = replace(
        learn(problem, measured.take(slice(FITTED))), posterior=condition(parameters, measured)
    )
    ground = build_ground(problem, np.asarray(problem.robots[0].start_m))
    return Scene(problem, ground, truth, belief, workspace_region(problem))


class Evader:
    """Walks on at one speed, turns at random, and turns back at the border.

    Parameters
    ----------
    near_m
        ``(2,)`` it starts 5 to 15 m from here.
    generator
        Of its walk.
    """

    def __init__(self, near_m: NDArray[np.float64], generator: np.random.Generator) -> None:
        self._generator = generator
        angle = generator.uniform(0.0, 2.0 * np.pi)
        away = generator.uniform(5.0, 15.0) * np.array([np.cos(angle), np.sin(angle)])
        self._place = np.clip(near_m + away, 5.0, SIDE_M - 5.0)
        self._heading = generator.uniform(0.0, 2.0 * np.pi)

    def walk(self) -> None:
        """One step."""
        self._heading += EVADER_TURN_RAD * self._generator.standard_normal()
        place = self._place + EVADER_STEP_M * self._direction()
        if not ((place > 0.0) & (place < SIDE_M)).all():
            self._heading += np.pi
            place = self._place + EVADER_STEP_M * self._direction()
        self._place = place

    def expected_m(self, horizon: int) -> NDArray[np.float64]:
        """Where it is expected at the end of each of the next steps, ``(horizon, 2)``."""
        steps = EVADER_STEP_M * np.arange(1, horizon + 1)[:, None]
        return np.clip(self._place + steps * self._direction(), 0.0, SIDE_M)

    def _direction(self) -> NDArray[np.float64]:
        return np.array([np.cos(self._heading), np.sin(self._heading)])


def context_in(
    place: Scene, belief: Belief, position_m: NDArray[np.float64], target_m: NDArray[np.float64]
) -> tuple[StepContext, Scorer]:
    """What one step knows, and what its candidates are judged by."""
    base = verifier_context(place.problem, place.ground.index, belief.posteriors, position_m)
    situation = step_context(base, place.region, Aim(target_m))
    scorer = Scorer(situation, ObjectiveValue(situation))
    return situation, scorer


def single_step(
    horizon: int, count: int, seed: int, munich_like: bool = False
) -> tuple[Scene, StepContext, Scorer]:
    """A cold step of a seeded scene: scene, situation, judge. The robot starts connected.

    Of the places of the scenes `seed`, `seed + 1000`, ... the first is taken whose start keeps the
    bound.
    """
    while True:
        place = scene(horizon, count, seed, munich_like)
        at = np.asarray(place.problem.robots[0].start_m)
        power = search_power(place.belief.posterior, at[None])
        if bound_margin_db(power.mean_db, power.deviation_db, -40.0, P_MIN)[0] >= 0.0:
            break
        seed += 1000
    evader = Evader(at, np.random.default_rng(seed))
    situation, scorer = context_in(place, place.belief, at, evader.expected_m(horizon))
    return place, situation, scorer


class TrackingDrive:
    """A closed loop, one step at a time, everything in it timed.

    The plan at the start fills the map from nothing and is not timed; nor is the step after it,
    whose measurement takes a copy of the shared belief's factor.

    Parameters
    ----------
    horizon, count, seed
        Of the scene.
    """

    def __init__(self, horizon: int, count: int, seed: int = 0) -> None:
        self._scene = scene(horizon, count, seed)
        self._planner = HorizonPlanner(self._scene.problem, self._scene.ground)
        self._belief = self._scene.belief
        self._at = np.asarray(self._scene.problem.robots[0].start_m)
        self._evader = Evader(self._at, np.random.default_rng(seed))
        self._plan: Plan | None = None
        self.wall_s: list[float] = []
        self.cpu_s: list[float] = []
        self.plans: list[Plan] = []
        for _ in range(2):
            self.step()
        self.wall_s.clear()
        self.cpu_s.clear()
        self.plans.clear()

    def step(self) -> Plan:
        """Move; then, timed: add the measurement to the belief, plan, and prove the plan."""
        if self._plan is not None:
            self._at = self._plan.positions_m[1]
        self._evader.walk()
        found = measure(self._scene.truth, self._at[None])
        target = self._evader.expected_m(self._scene.problem.planner.horizon)
        wall, cpu = perf_counter(), process_time()
        self._belief = update(self._belief, found)
        situation, scorer = context_in(self._scene, self._belief, self._at, target)
        self._plan = self._planner.plan(situation, scorer, self._plan)
        self.wall_s.append(perf_counter() - wall)
        self.cpu_s.append(process_time() - cpu)
        self.plans.append(self._plan)
        return self._plan
