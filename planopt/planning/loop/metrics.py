"""Metrics and realised costs of a run and of its robots (equation 6.12)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields

import numpy as np
from scipy.special import chdtri

from planopt.arrays import Floats, Mask
from planopt.channel.calibration import ReliabilityBin, reliability
from planopt.channel.connectivity_law import serving_power_dbm
from planopt.channel.ground_truth import Truth, mean_power_dbm, true_power_dbm
from planopt.channel.joint import longest_run
from planopt.planning.certificate import Hole, holes_along
from planopt.planning.loop.log import ChannelLog, Metrics, Outcome, RobotRun, StepLog, TargetLog
from planopt.planning.plan import Plan, Rung, Verdict
from planopt.planning.proof.motion import is_at_goal, stands
from planopt.planning.proof.rule import rule_of
from planopt.planning.reservations import (
    driven_motion,
    least_moving_clearances_m,
    least_separations_m,
)
from planopt.planning.tolerances import STEP_PAD_M
from planopt.problems.channel_setup import MeasuredTruth
from planopt.problems.problem import Problem, problem_of_robot
from planopt.problems.robot import Robot
from planopt.robots.dynamics import Drive
from planopt.world.clearance import ObstacleIndex, index_obstacles, segments_clear
from planopt.world.lattice import RoadMap, cheapest_paths, node_at, nodes_in_reach, route_from

COSTS = ("realised_cost_m", "clairvoyant_cost_m", "cost_ratio")
"""Names of the realised costs of a run to goals (:func:`run_costs`)."""

_SHARES = (
    *("true_connected_share", "predicted_min_connectivity", "target_lost", "delivered"),
    *("stated_times_connected", "least_connected_share", "reading_share"),
)
_NOT_NEGATIVE = (
    *("goal_time_s", "path_m", "longest_outage_m", "longest_outage_s", "measured_steps"),
    *("time_averaged_trace_p", "time_averaged_normalised_trace_p", "final_normalised_trace_p"),
    *("final_trace_p", "time_averaged_det_p", "nees", "nis", "nis_low", "nis_high", "data_mbit"),
    *("rms_db", "mean_squared_error_db2", "rms_without_multipath_db", "path_loss_variance_db2"),
    *COSTS,
)
POSSIBLE = dict.fromkeys(_SHARES, (0.0, 1.0)) | dict.fromkeys(_NOT_NEGATIVE, (0.0, np.inf))
"""Valid range of each metric; other metrics have the range `ANY`."""
LOST_RATIO = 3.0  # Ratio of tr P to its initial value above which a target counts as lost

ANY = (-np.inf, np.inf)


def metrics_of(
    log: StepLog, plans: Sequence[Plan], learnt: Sequence[bool], arrival: int | None
) -> Metrics:
    """Return the metrics of a robot; metrics over steps are NaN for a run without steps."""
    # `learnt` flags steps with a measurement; `arrival` is the step of arrival at the goal.
    lengths = np.linalg.norm(np.diff(log.positions_m, axis=0), axis=1)
    # A measured ground truth defines no connection between its readings.
    known = ~np.isnan(log.true_dbm[1:])
    connected = log.connected[1:]
    outage_m = longest_run(lengths, log.disconnected[1:])
    gains = [plan.polish_gain for plan in plans]
    nothing = float("nan")
    return Metrics(
        goal_time_s=float(log.t_s[arrival]) if arrival is not None else nothing,
        path_m=float(lengths.sum()),
        true_connected_share=float(connected[known].mean()) if known.any() else nothing,
        longest_outage_m=float(outage_m) if connected.size else nothing,
        predicted_min_connectivity=float(log.connectivity[1:].min()) if connected.size else nothing,
        polish_gain=_mean_of_known(gains),
        measured_steps=sum(learnt),
    )


def run_metrics(
    problem: Problem,
    runs: Sequence[RobotRun],
    target: TargetLog | None,
    channel: ChannelLog | None,
    costs: Mapping[str, float],
) -> dict[str, float]:
    """Return the metrics of a run over all robots, keyed by the metric's name."""
    found: dict[str, float] = {}
    each = [run.metrics for run in runs]
    led = [robot.goal_m is not None for robot in problem.robots]
    if any(led):
        times_s = [m.goal_time_s for m, goes in zip(each, led, strict=True) if goes]
        found["goal_time_s"] = float(max(times_s))
    if target is not None:
        found["time_averaged_trace_p"] = float(target.station_variance_m2[1:].mean())
        found["final_trace_p"] = float(target.station_variance_m2[-1])
        normalised = target.normalised_trace_p
        found["time_averaged_normalised_trace_p"] = float(normalised[1:].mean())
        found["final_normalised_trace_p"] = float(normalised[-1])
        largest_m2 = float(target.station_variance_m2.max())
        found["target_lost"] = float(largest_m2 > LOST_RATIO * target.station_variance_m2[0])
        found["delivered"] = float(target.delivered.mean())
        found["time_averaged_det_p"] = float(target.station_determinant_m4[1:].mean())
        found["nees"] = float(target.nees[1:].mean())
        measured = target.nis[np.isfinite(target.nis)]
        if measured.size:
            low, high = nis_interval(measured.size)
            found |= {"nis": float(measured.mean()), "nis_low": low, "nis_high": high}
    if channel is not None:
        last = {part.name: float(getattr(channel, part.name)[-1]) for part in fields(channel)}
        found |= {**last, "mean_squared_error_db2": last["rms_db"] ** 2}
        found["trace_m_db"] = found.pop("theta_variance_db")
    found["path_m"] = float(sum(m.path_m for m in each))
    found["true_connected_share"] = float(np.mean([m.true_connected_share for m in each]))
    if isinstance(problem.channel.truth, MeasuredTruth):
        powers = np.concatenate([run.log.true_dbm[1:] for run in runs])
        found["reading_share"] = float(np.isfinite(powers).mean()) if powers.size else float("nan")
    found["longest_outage_m"] = float(max(m.longest_outage_m for m in each))
    found["predicted_min_connectivity"] = float(min(m.predicted_min_connectivity for m in each))
    found["polish_gain"] = _mean_of_known([m.polish_gain for m in each])
    found["measured_steps"] = float(sum(m.measured_steps for m in each))
    found |= rule_of(problem).run_metrics(problem, [run.log.connected[1:] for run in runs])
    step_s = problem.planner.step_s
    motions = [driven_motion(run.log.positions_m, run.drive, step_s) for run in runs]
    if len(motions) > 1 and problem.constraints.separation_m > 0.0:
        # A robot without steps has no separation during a step.
        apart_m = least_separations_m(motions)
        found["min_separation_m"] = float(np.min(apart_m)) if apart_m.size else float("nan")
    if problem.workspace.moving and len(runs[0].log.t_s) > 1:
        clearances = least_moving_clearances_m(problem, motions)
        found["min_moving_clearance_m"] = float(clearances.min())
    return found | dict(costs)


def _mean_of_known(values: Sequence[float]) -> float:
    """Return the mean of the values that are not NaN; NaN if there are none."""
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else float("nan")


def nis_interval(count: int) -> tuple[float, float]:
    """Return the 95 % interval of a consistent filter's NIS, averaged over `count` values."""
    # The `count` values are independent, chi-square with two degrees of freedom (equation 4.19).
    return float(chdtri(2 * count, 0.975)) / count, float(chdtri(2 * count, 0.025)) / count


def run_reliability(runs: Sequence[RobotRun]) -> tuple[ReliabilityBin, ...]:
    """Return the reliability bins of P(connected) over all steps and robots of a run."""
    known = ~np.isnan(np.concatenate([run.log.true_dbm[1:] for run in runs]))
    predicted = np.concatenate([run.log.connectivity[1:] for run in runs])[known]
    connected = np.concatenate([run.log.connected[1:] for run in runs])[known]
    return reliability(predicted, connected, np.zeros(len(predicted), dtype=np.intp))


def run_holes(run: RobotRun) -> tuple[Hole, ...]:
    """Return the coverage holes of an executed path: steps that missed p_min when planned."""
    log = run.log
    return holes_along(log.positions_m, log.connectivity, log.relaxation_db > 0.0)


def true_serving_dbm(problem: Problem, truths: Sequence[Truth], positions_m: Floats) -> Floats:
    """Return true serving powers (n,), shifted so that the first station's threshold applies."""
    # A robot is connected if this power reaches `problem.stations[0].true_threshold_dbm`.
    powers = np.stack([true_power_dbm(truth, positions_m) for truth in truths])
    return serving_power_dbm(powers, [radio.true_threshold_dbm for radio in problem.stations])


def step_log(problem: Problem, track_m: Floats, true_dbm: Floats, plans: Sequence[Plan]) -> StepLog:
    """Return the step log of a robot; row 0 has the first plan's prediction."""
    # Shapes: track_m (steps + 1, 2), robot positions, the start first; true_dbm (steps + 1,), true
    # power there.

    def column(at_start: float, values: Sequence[float]) -> Floats:
        return np.array([at_start, *values], dtype=float)

    def predicted(name: str) -> Floats:
        each = [getattr(plan, name) for plan in plans]
        return column(each[0][0] if each else np.nan, [values[1] for values in each])

    relaxation = [
        dict(zip(p.certificate.relaxed_steps, p.certificate.relaxation_db, strict=True)).get(1, 0.0)
        for p in plans
    ]
    return StepLog(
        t_s=problem.planner.step_s * np.arange(len(track_m), dtype=np.float64),
        positions_m=track_m,
        predicted_dbm=predicted("mean_dbm"),
        deviation_db=predicted("deviation_db"),
        connectivity=predicted("connectivity"),
        true_dbm=true_dbm,
        connected=true_dbm >= problem.stations[0].true_threshold_dbm,
        step_s=column(0.0, [p.wall_s for p in plans]),
        polish_gain_s=column(0.0, [p.gain for p in plans]),
        relaxation_db=column(0.0, relaxation),
        rung=(Rung.PLAN, *(p.rung for p in plans)),
        verdict=(Verdict.VERIFIED, *(p.verdict for p in plans)),
    )


def driven(robot: Robot, plans: Sequence[Plan]) -> Drive | None:
    """Return states and inputs of a robot's run; None for the single integrator."""
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
    track_m: Floats,
    true_dbm: Floats,
    plans: Sequence[Plan],
    learnt: Sequence[bool],
    ended: tuple[Outcome, str],
) -> RobotRun:
    """Return one robot's results of a run, from its track and the executed plans."""
    # Shapes: track_m, true_dbm (steps + 1, 2).
    log = step_log(problem, track_m, true_dbm, plans)
    drive = driven(problem.robots[0], plans)
    arrival: int | None = None
    if ended[0] is Outcome.REACHED and problem.robots[0].goal_m is not None:
        states = track_m if drive is None else drive.states
        away = [not (is_at_goal(problem, state[:2]) and stands(problem, state)) for state in states]
        arrival = int(np.flatnonzero(away).max(initial=-1)) + 1
    return RobotRun(
        robot=problem.robots[0].name,
        outcome=ended[0],
        reason=ended[1],
        log=log,
        metrics=metrics_of(log, plans, learnt, arrival),
        drive=drive,
    )


SHORTCUT_NODES = 40
"""Maximum number of lattice nodes that a straight segment of the clairvoyant path may skip."""
COST_CELLS = 0.1  # Sampling interval of path costs, in cells of the true map
SEARCHED_CELLS = 0.5
"""Sampling interval of costs in the clairvoyant search, in cells of the true map."""
IsOut = Callable[[Floats], Mask]
"""Function that maps positions (n, 2) to a mask (n,) of those out of contact."""


def run_costs(
    problem: Problem,
    road_maps: Sequence[RoadMap],
    truths: Sequence[Truth],
    tracks_m: Sequence[Floats],  # (n + 1, 2) positions of each robot
    outcome: Outcome,
) -> dict[str, float]:
    """Return the cost of a run to goals, the cost of clairvoyant paths, and their ratio."""
    # Clairvoyant paths ignore other robots. The ratio is NaN for runs that did not arrive.
    if not road_maps:
        return {}
    index = index_obstacles(problem.workspace)
    driven = least = 0.0
    for number, (road_map, track) in enumerate(zip(road_maps, tracks_m, strict=True)):
        own = problem_of_robot(problem, number)
        path = clairvoyant_path(own, road_map, index, truths)
        driven += realised_cost_m(own, truths, track)
        least += realised_cost_m(own, truths, path)
    arrived = outcome is Outcome.REACHED and least > 0.0
    ratio = driven / least if arrived else float("nan")
    return dict(zip(COSTS, (driven, least, ratio), strict=True))


def realised_cost_m(problem: Problem, truths: Sequence[Truth], places_m: Floats) -> float:
    """Return the length of a path (n + 1, 2), plus outage price times length out of contact."""

    def is_out(places: Floats) -> Mask:
        return true_serving_dbm(problem, truths, places) < problem.stations[0].true_threshold_dbm

    spacing = COST_CELLS * _cell_m(truths)
    return float(_costs_m(problem, is_out, places_m[:-1], places_m[1:], spacing).sum())


def clairvoyant_path(
    problem: Problem, road_map: RoadMap, index: ObstacleIndex, truths: Sequence[Truth]
) -> Floats:
    """Return waypoints (k, 2) of the cheapest path to the goal for a known ground truth."""
    thresholds = [radio.true_threshold_dbm for radio in problem.stations]

    def is_out(places: Floats) -> Mask:
        powers = np.stack([mean_power_dbm(truth, places) for truth in truths])
        return serving_power_dbm(powers, thresholds) < thresholds[0]

    def cost_m(begins: Floats, ends: Floats) -> Floats:
        return _costs_m(problem, is_out, begins, ends, SEARCHED_CELLS * _cell_m(truths))

    nodes_m = road_map.nodes_m
    moves = cost_m(nodes_m[road_map.edge_from], nodes_m[road_map.edge_to])
    paths = cheapest_paths(road_map, node_at(road_map, np.asarray(problem.goal_m)), moves)
    start = np.asarray(problem.robots[0].start_m, dtype=np.float64)
    reach_m, clearance_m = problem.step_length_m - STEP_PAD_M, problem.constraints.clearance_m
    nodes, _ = nodes_in_reach(road_map, index, start, reach_m, clearance_m)
    joining = cost_m(np.broadcast_to(start, (len(nodes), 2)), nodes_m[nodes])
    first = int(nodes[np.argmin(joining + paths.cost_m[nodes])])
    places = np.vstack([start, nodes_m[route_from(road_map, paths, first, np.inf)]])
    return _straightened(problem, index, places, cost_m)


def _cell_m(truths: Sequence[Truth]) -> float:
    """Return the smallest cell side of the true maps."""
    return min(min(truth.raster.cell_m) for truth in truths)


def _costs_m(
    problem: Problem, is_out: IsOut, begins_m: Floats, ends_m: Floats, spacing_m: float
) -> Floats:
    """Return the costs (n,) of straight segments, integrated at intervals of `spacing_m`."""
    lengths = np.linalg.norm(ends_m - begins_m, axis=1)
    counts = np.maximum(np.ceil(lengths / spacing_m), 1.0).astype(np.intp)
    owner = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(owner)) - np.repeat(counts.cumsum() - counts, counts)
    along = ((number + 0.5) / counts[owner])[:, None]
    out = is_out(begins_m[owner] + along * (ends_m - begins_m)[owner])
    share = np.bincount(owner, weights=out, minlength=len(counts)) / counts
    return lengths * (1.0 + problem.reach.outage_price * share)


def _straightened(
    problem: Problem,
    index: ObstacleIndex,
    places_m: Floats,
    cost_m: Callable[[Floats, Floats], Floats],
) -> Floats:
    """Return the cheapest collision-free path through a subset of a path's points (n, 2)."""
    count = len(places_m)
    first, second = np.triu_indices(count, 1)
    near = second - first <= SHORTCUT_NODES
    first, second = first[near], second[near]
    wanted = problem.constraints.clearance_m
    clear = segments_clear(index, places_m[first], places_m[second], wanted)
    # Moves of the lattice are collision-free by construction.
    clear |= second == first + 1
    first, second = first[clear], second[clear]
    cost = cost_m(places_m[first], places_m[second])
    best, came = np.full(count, np.inf), np.zeros(count, dtype=np.intp)
    best[0] = 0.0
    for k in range(1, count):
        arriving = np.flatnonzero(second == k)
        total = best[first[arriving]] + cost[arriving]
        chosen = int(np.argmin(total))
        best[k], came[k] = total[chosen], first[arriving[chosen]]
    path = [count - 1]
    while path[-1] > 0:
        path.append(int(came[path[-1]]))
    return places_m[path[::-1]]
