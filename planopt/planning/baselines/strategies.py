"""Strategies of communication of [GM11] for tracking: what a plan takes connection to depend on.

The planner is the one of the whole package with another channel in its place: path loss without
shadowing, a disc in which all packets arrive, or a link that is never lost. One step ahead there
is also what multipath is known to be at places that were measured. The verifier judges what comes
of it by all that is known, as always.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters
from planopt.channel.posterior import condition
from planopt.errors import InputError
from planopt.planning.baselines.baseline import released
from planopt.planning.history import BEGINNING
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.judge import Judge
from planopt.planning.plan import Plan
from planopt.planning.scene import Ground
from planopt.planning.search.taut_way import WaysFrom, stops_along
from planopt.planning.tolerances import STEP_PAD_M
from planopt.planning.values.context import StepContext
from planopt.planning.values.objective_value import ObjectiveValue
from planopt.problems.problem import Problem

EDGE_STD_DB = 0.1
"""Deviation of power at the edge of a disc: connection is certain or ruled out but for a rim of
about one hundredth of its radius, in which a solver has a slope."""

CERTAIN_DB = 300.0
"""So much above any threshold no packet is lost."""

Assumed = Callable[[ChannelParameters], ChannelParameters]


def path_loss_only(parameters: ChannelParameters) -> ChannelParameters:
    """Return the channel as it is, of which nothing has been measured: path loss is all."""
    return parameters


def informed_disk(parameters: ChannelParameters) -> ChannelParameters:
    """Return a channel of path loss alone: connected within a disc, and not beyond."""
    return replace(parameters, shadow_std_db=0.0, multipath_std_db=EDGE_STD_DB)


def unaware(parameters: ChannelParameters) -> ChannelParameters:
    """Return a channel that loses no packet."""
    return replace(parameters, k_pl_db=parameters.k_pl_db + CERTAIN_DB)


def require_tracking(problem: Problem) -> None:
    """Raise an InputError unless a problem tracks a target for one station."""
    if not any(term.sensor for term in problem.terms) or len(problem.stations) > 1:
        raise InputError(
            f"is {problem.planner.name}, which tracks a target for one station",
            file=problem.file,
            key="planner.name",
            remedy="use auto",
        )


class StrategyPlanner:
    """Plans for one robot that tracks a target, on a channel that it assumes."""

    def __init__(self, problem: Problem, ground: Ground, assumed: Assumed) -> None:
        require_tracking(problem)
        self._problem, self._ground, self._assumed = problem, ground, assumed
        inner = replace(problem, planner=replace(problem.planner, name="auto"))
        self._planner = HorizonPlanner(inner, ground)

    def plan(self, situation: StepContext, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is; arguments as of the horizon planner."""
        begun = perf_counter()
        believed = situation.posterior
        k_pl_db, n_pl = (float(value) for value in believed.theta)
        parameters = replace(believed.parameters, k_pl_db=k_pl_db, n_pl=n_pl)
        nothing = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=np.bool_))
        channel = condition(self._assumed(parameters), nothing, theta="known")
        path = self._home(situation) if self._assumed is informed_disk else None
        if path is None:
            # Whoever assumes a channel has learned nothing of it on the run either.
            seen = replace(situation, posteriors=(channel,), uncertain=None, history=BEGINNING)
            assuming = replace(judge, context=seen, objective=ObjectiveValue(seen))
            path = self._planner.plan(seen, assuming, warm).positions_m[1:]
        return released(judge, path, begun)

    def _home(self, situation: StepContext) -> NDArray[np.float64] | None:
        """The shortest path (N, 2) towards the station; None if the disc is within reach."""
        believed, station = situation.posterior, self._problem.stations[0]
        k_pl_db, n_pl = believed.theta
        slant = 10.0 ** ((k_pl_db - station.threshold_dbm) / (10.0 * n_pl))
        radius = np.sqrt(max(slant**2 - station.height_m**2, 0.0))
        base, here = np.asarray(station.position_m), situation.position_m
        horizon, longest = self._problem.planner.horizon, self._problem.step_length_m - STEP_PAD_M
        if np.linalg.norm(base - here) <= radius + horizon * longest:
            return None
        nodes = self._ground.road_map.nodes_m
        ways = WaysFrom(self._problem, self._ground, here)
        away = np.where(np.isfinite(ways.length_m), np.linalg.norm(nodes - base, axis=1), np.inf)
        nearest = int(away.argmin())
        stops = stops_along(ways.turns_m(nearest, nodes[nearest]), longest)[1:]
        return np.concatenate([stops, np.repeat(stops[-1:], horizon, axis=0)])[:horizon]
