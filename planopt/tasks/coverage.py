"""Task coverage: its actions, and their results as JSON, tables, text and figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.arrays import Floats, Mask, proof_seconds
from planopt.bounds.bound import relative_gap
from planopt.coverage.assignment import NONE
from planopt.coverage.cost_bounds import EFFORT_S, cost_bound
from planopt.coverage.limits import Motion, packing_reach_m
from planopt.coverage.optima import STARTS, best_deployment
from planopt.coverage.simulation import ABSENT, NetworkController, NetworkRun, simulate_network
from planopt.coverage.verify import SignalModel, estimate_fault, verify_moves
from planopt.files.tables import Column, Data, finite
from planopt.tasks.coverage_build import CoverageProblem, build, has_room, overlapping
from planopt.tasks.coverage_tables import CoverageFile
from planopt.tasks.task import Task, TaskResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from planopt.report import NetworkPicture

STEPS_FILE, NETWORK_FILE, EVENTS_FILE = "steps.csv", "network.csv", "events.csv"
READINGS_FILE = "readings.csv"
RUN_PICTURE, PLAN_PICTURE = "run.png", "plan.png"

STEP_COLUMNS = (
    Column("robot", "name of the agent", kind="text", required=True),
    Column("step", "number of the step; 0 is the start", kind="count", required=True),
    Column("t_s", "time", "s", required=True),
    Column("x_m", "position", "m", required=True),
    Column("y_m", "position", "m", required=True),
    Column("vx_m_s", "velocity", "m/s", required=True),
    Column("vy_m_s", "velocity", "m/s", required=True),
    Column("heading_rad", "heading", "rad", required=True),
    Column("state", "`covers`, `absent` or the event that the agent responds to", kind="text"),
    Column("target_x_m", "target of the step that begins here", "m"),
    Column("target_y_m", "target of the step that begins here", "m"),
    Column("count", "the agent's count of the agents"),
)
NETWORK_COLUMNS = (
    Column("step", "number of the step", kind="count", required=True),
    Column("t_s", "time", "s", required=True),
    Column("cost", "coverage cost", required=True, largest=math.inf),
    Column("residual_m", "largest distance from rest at a target", "m", required=True),
    Column("count_messages", "messages for counting", kind="count", required=True),
    Column(
        "assignment_messages",
        "messages with estimates and lists of agents",
        kind="count",
        required=True,
    ),
    Column("reading_messages", "messages with sensor readings", kind="count", required=True),
)
EVENT_COLUMNS = (
    Column("event", "name of the event", kind="text", required=True),
    Column("step", "number of the step", kind="count", required=True),
    Column("t_s", "time", "s", required=True),
    Column("there", "whether the event is there", kind="count", required=True),
    Column("x_m", "position of the event", "m", required=True),
    Column("y_m", "position of the event", "m", required=True),
    Column("estimate_x_m", "best estimate of any agent; empty before the event is detected", "m"),
    Column("estimate_y_m", "best estimate of any agent; empty before the event is detected", "m"),
    Column("std_m", "standard deviation of the best estimate", "m"),
    Column("readings", "number of readings in the best estimate", kind="count", required=True),
    Column("first_step", "step of the earliest of these readings", kind="count", required=True),
    Column("made_step", "step in which the best estimate was made", kind="count", required=True),
    Column("informed", "number of agents that know of the event", kind="count", required=True),
    Column("spread_m", "largest distance of a responding agent's estimate from the best", "m"),
    Column("wanted", "number of agents wanted", kind="count", required=True),
    Column("responding", "number of agents that respond", kind="count", required=True),
)
READING_COLUMNS = (
    Column("event", "name of the event", kind="text", required=True),
    Column("step", "number of the step", kind="count", required=True),
    Column("x_m", "position of the agent", "m", required=True),
    Column("y_m", "position of the agent", "m", required=True),
    Column("signal", "reading of the sensor, in the unit of its strength", required=True),
)
COVERS, AWAY = "covers", "absent"  # Names of the states of agents that respond to no event
ON_TARGET_M = 1e-9  # Rounding tolerance of the settling distance
CHECKED = 10
"""Number of estimates of each event, evenly spaced over its steps, that the verifier recomputes."""
BOUND_METHOD = "Lagrangian relaxation with a price of each position"
"""Method of the lower bound on the coverage cost."""
COST_SHARE = 1e-6  # Relative tolerance by which the lower bound may exceed the coverage cost


def agent_name(number: int) -> str:
    """Return the name of an agent in outputs."""
    return f"agent{number}"


def simulate(
    problem: CoverageProblem,
    *,
    seed: int,
    on_step: Callable[[], None] = lambda: None,
    saved: Mapping[str, Data] | None = None,
) -> TaskResult:
    """Simulate a network; the seed determines starts, noise and losses.

    For a check, the steps start from the states in the `saved` tables.
    """
    generator = np.random.default_rng(seed)
    starts_m = problem.starts(generator)
    motions = () if saved is None else _motions_of(saved[STEPS_FILE], len(starts_m))
    run = simulate_network(problem.scene, starts_m, problem.mover, generator, on_step, motions)
    planner, events = problem.config.planner, event_results(problem, run)
    outcome, reason = outcome_of(problem, run, events)
    data = {
        "horizon": planner.horizon,
        "planner": planner.name,
        "outcome": outcome,
        "reason": reason,
        "metrics": metrics(problem, run),
        "rungs": {planner.name: len(run.costs)},
        "events": events,
        "robots": _paths(run.times_s, run.positions_m),
    }
    return TaskResult(problem, data, tables_of(problem, run), run)


def _paths(times_s: Floats, positions_m: Floats) -> list[dict[str, Any]]:
    """Return the paths of agents for JSON, from times (T,) and positions (T, n, 2)."""
    x, y = positions_m.transpose(2, 1, 0).tolist()
    rows = zip(x, y, strict=True)
    return [
        {"name": agent_name(number), "t_s": times_s.tolist(), "x_m": x, "y_m": y}
        for number, (x, y) in enumerate(rows)
    ]


def _motions_of(steps: Data, agents: int) -> list[Motion]:
    """Return the saved state of each step; empty if the number of rows is wrong."""
    if len(steps["step"]) % agents:
        return []
    names = ("x_m", "y_m", "vx_m_s", "vy_m_s", "heading_rad")
    states = np.stack([steps[name].reshape(agents, -1).T for name in names], axis=2)
    return [Motion(each[:, :2], each[:, 2:4], each[:, 4]) for each in states]


def controller(problem: CoverageProblem, *, seed: int) -> NetworkController:
    """Return the controller of a network; a seed determines starts and random numbers."""
    generator = np.random.default_rng(seed)
    return NetworkController(problem.scene, problem.starts(generator), problem.mover, generator)


def faults(result: TaskResult) -> list[str]:
    """Return the constraint violations that the verifier finds in the moves of a run."""
    run: NetworkRun = result.value
    problem = cast("CoverageProblem", result.problem)
    world, limits = problem.config.world, problem.config.limits
    moving = (run.positions_m, run.velocities_m_s, run.headings_rad)
    if not all(np.isfinite(each).all() for each in moving):
        return [f"{STEPS_FILE}: a position, velocity or heading is not finite"]
    free = shapely.box(*world.bounds_m) if world.bounds_m else shapely.Polygon(world.outline_m)
    for obstacle in problem.obstacles:
        free = free.difference(obstacle.polygon)
    reasons = list[str]()
    for step in range(len(run.costs)):
        who = np.flatnonzero(run.states[step] != ABSENT)
        before, after = (Motion(*(each[at, who] for each in moving)) for at in (step, step + 1))
        found = verify_moves(cast("shapely.Polygon", free), before, after, limits, problem.radio)
        reasons += [
            f"{STEPS_FILE}: {agent_name(int(who[fault.agent]))} has a fault of {fault.kind} in "
            f"step {step}: {fault.value:.6g}, {fault.limit:g} is allowed"
            for fault in found
        ]
        idle = np.flatnonzero(run.states[step] == ABSENT)
        away = idle[(run.positions_m[step, idle] != run.positions_m[step + 1, idle]).any(axis=1)]
        reasons += [
            f"{STEPS_FILE}: {agent_name(each)} moves in step {step} and takes no part"
            for each in away.tolist()
        ]
    return reasons + _estimate_faults(problem, run)


def _estimate_faults(problem: CoverageProblem, run: NetworkRun) -> list[str]:
    """Return faults of estimates and standard deviations, recomputed from all readings."""
    table, sensing, reasons = problem.config.sensor, problem.scene.sensing, list[str]()
    if table is None or sensing is None:
        return reasons
    known, hull = table.strength_known, problem.scene.ground.hull
    model = SignalModel(
        table.noise_std, table.strength, known, table.scale_m, sensing.speed_std_m_s
    )
    for number, event in enumerate(problem.scene.events):
        rows, source = run.readings[number], run.sources[:, number]
        place_m, std_m = run.estimates_m[:, number], run.stds_m[:, number]
        made = np.flatnonzero((std_m < hull.radius_m) & (source[:, 2] == np.arange(len(std_m))))
        for step in made[np.linspace(0, len(made) - 1, min(CHECKED, len(made))).astype(np.intp)]:
            count, first, _ = source[step]
            held = rows[(rows[:, 0] >= first) & (rows[:, 0] <= step)]
            inner = bool(hull.excess_m(place_m[step, None])[0] < -std_m[step])
            if len(held) != count:
                continue
            ages_s = problem.scene.time_step_s * (step - held[:, 0])
            fault = estimate_fault(
                model, held[:, 1:3], held[:, 3], ages_s, place_m[step], float(std_m[step]), inner
            )
            if fault is not None:
                reasons.append(f"{EVENTS_FILE}: {event.name}, step {step}: {fault}")
    return reasons


def solve(problem: CoverageProblem, *, seed: int, prove_s: float = EFFORT_S) -> TaskResult:
    """Return the best deployment from several starts, with a lower bound of the cost.

    The bound takes about `prove_s` seconds of processor time on a common core. An interrupt ends
    it; the bound is then that of the least time.
    """
    prove_s, generator = proof_seconds(prove_s), np.random.default_rng(seed)
    ground, starts_m = problem.scene.ground, problem.starts(generator)
    found = best_deployment(ground, len(starts_m), STARTS, generator, first_m=starts_m)
    try:
        bound = cost_bound(ground, found.places_m, prove_s)
    except KeyboardInterrupt:
        if prove_s <= EFFORT_S:
            raise
        prove_s = EFFORT_S
        bound = cost_bound(ground, found.places_m, prove_s)
    body_m = problem.config.limits.body_radius_m
    cost = ground.cover(found.places_m).cost
    fits = bool(has_room(ground, found.places_m, body_m).all())
    fits &= overlapping(found.places_m, body_m) is None
    data = {
        "horizon": None,
        "planner": "several_starts",
        "termination": "settled",
        "verdict": "verified" if fits and bound <= cost * (1.0 + COST_SHARE) else "violated",
        "sense": "min",
        "objective": cost,
        "bound": bound if bound > 0.0 else None,
        "gap": relative_gap(cost, bound, "min") if bound > 0.0 else None,
        "bound_method": BOUND_METHOD if bound > 0.0 else None,
        "prove_s": prove_s,
        "robots": _paths(np.zeros(1), found.places_m[None]),
        "start_costs": found.costs.tolist(),
    }
    return TaskResult(problem, data, value=found)


def outcome_of(
    problem: CoverageProblem, run: NetworkRun, events: Sequence[Mapping[str, Any]]
) -> tuple[str, str]:
    """Return the outcome (settled, served, unserved or not_settled) and its reason."""
    last_s = float(run.times_s[-2])
    for entry in events:
        if entry["appears_s"] > last_s:
            continue
        if entry["detected_s"] is None:
            return "unserved", f"{entry['name']} was not detected"
        if entry["served_s"] is None:
            return "unserved", f"{entry['name']} never had its agents in place"
    moving = any(any(each.velocity_m_s) and each.is_there(last_s) for each in problem.scene.events)
    if run.settled:
        return "settled", f"after {_settled_s(problem, run):g} s"
    if moving:
        return "served", f"an event moves on at {last_s:g} s"
    due = (problem.scene.joins_s <= last_s) & (last_s < problem.scene.leaves_s)
    waiting = np.flatnonzero(due & (run.states[-1] == ABSENT))
    if len(waiting):
        return "not_settled", f"{agent_name(int(waiting[0]))} waits for room to join"
    return "not_settled", (
        f"an agent is {run.residuals_m[-1]:.3g} m from its target after {last_s:g} s, "
        f"settled is {problem.scene.settled_m:.3g} m"
    )


def metrics(problem: CoverageProblem, run: NetworkRun) -> dict[str, Any]:
    """Return the metrics of a run: cost, path length, energy, messages, counts."""
    step_s = float(run.times_s[1] - run.times_s[0])
    driven_m = np.linalg.norm(np.diff(run.positions_m, axis=0), axis=2)
    members = run.states != ABSENT
    true = members.sum(axis=1)[:, None]
    wrong = np.abs(np.rint(run.counts) - true)[members]
    kinds = ("counting", "assignment", "readings")
    sent = dict(zip(kinds, run.messages.sum(axis=0).tolist(), strict=True))
    return {
        "steps": len(run.costs),
        "cost_first": float(run.costs[0]),
        "cost_last": float(run.costs[-1]),
        "cost_mean": float(run.costs.mean()),
        "residual_m": float(run.residuals_m[-1]),
        "settled_s": _settled_s(problem, run),
        "path_m": float(driven_m.sum()),
        "energy_m2_s": float((driven_m**2).sum() / step_s),
        "messages": {**sent, "all": int(run.messages.sum())},
        "count_error_most": float(wrong.max()) if len(wrong) else 0.0,
    }


def event_results(problem: CoverageProblem, run: NetworkRun) -> list[dict[str, Any]]:
    """Return the times of detection, service and end of each event, and its estimation error."""
    results = list[dict[str, Any]]()
    times_s = run.times_s[:-1]
    near_m = problem.scene.settled_m + ON_TARGET_M
    for number, event in enumerate(problem.scene.events):
        known = np.isfinite(run.estimates_m[:, number, 0])
        there = np.array([event.is_there(time_s) for time_s in times_s.tolist()])
        team = run.states == number
        responding = team.sum(axis=1)
        in_place = (~team | _in_place(problem, run, number, near_m)).all(axis=1)
        wanted = run.wanted[:, number]
        served = known & there & (responding == wanted) & (wanted > 0)
        if not any(event.velocity_m_s):
            served &= in_place
        places = np.array([event.place_at(time_s) for time_s in times_s.tolist()])
        square_m2 = ((run.beliefs_m[:, number] - places[:, None]) ** 2).sum(axis=2)
        # Root mean square over the agents that respond, or over all that know the event
        counted = team | (np.isfinite(square_m2) & (responding == 0)[:, None])
        total_m2 = np.where(counted, square_m2, 0.0).sum(axis=1)
        error_m = np.sqrt(total_m2 / np.maximum(counted.sum(axis=1), 1))
        both = np.flatnonzero(known & there)
        ended = np.flatnonzero(~known & ~there & (times_s >= event.ends_s))
        results.append(
            {
                "name": event.name,
                "appears_s": event.appears_s,
                "ends_s": finite(event.ends_s),
                "detected_s": _first_s(times_s, known & there),
                "served_s": _first_s(times_s, served),
                "given_up_s": float(times_s[ended[0]]) if len(ended) else None,
                "wanted": int(wanted[both[-1]]) if len(both) else 0,
                "responding": int(responding[both[-1]]) if len(both) else 0,
                "error_m": float(error_m[both[-1]]) if len(both) else None,
                "std_m": finite(float(run.stds_m[both[-1], number])) if len(both) else None,
                "switches": int((np.diff(team.astype(np.int8), axis=0) == 1).sum())
                + int(responding[0]),
            }
        )
    return results


def _in_place(problem: CoverageProblem, run: NetworkRun, number: int, near_m: float) -> Mask:
    """Return a mask (T, n) of agents within `near_m` of their targets, or at rest at an event."""
    control = problem.config.control
    here = run.positions_m[:-1]
    in_place = np.linalg.norm(run.targets_m - here, axis=2) <= near_m
    body_m = problem.config.limits.body_radius_m
    if body_m == 0.0:
        return in_place
    share = float(control.gains.shares(np.array([True]), control.time_step_s)[0])
    still = np.linalg.norm(np.diff(run.positions_m, axis=0), axis=2) <= share * near_m
    off_m = np.linalg.norm(here - run.estimates_m[:, number, None], axis=2)
    team = (run.states == number).sum(axis=1).tolist()
    reach_m = np.array([packing_reach_m(agents, body_m) for agents in team])
    reach_m += near_m + (problem.scene.stand_off_m or 0.0)
    return in_place | (still & (off_m <= reach_m[:, None]))


def _settled_s(problem: CoverageProblem, run: NetworkRun) -> float | None:
    """Return the time from which all agents were settled; None if unsettled at the end."""
    if not run.settled:
        return None
    off = np.flatnonzero(run.residuals_m > problem.scene.settled_m + ON_TARGET_M)
    return float(run.times_s[off[-1] + 1]) if len(off) else 0.0


def _first_s(times_s: Floats, which: Mask) -> float | None:
    """Return the first time at which a mask holds; None if it never does."""
    return float(times_s[which.argmax()]) if which.any() else None


def tables_of(problem: CoverageProblem, run: NetworkRun) -> dict[str, Data]:
    """Return the tables ``steps.csv``, ``network.csv`` and ``events.csv``."""
    steps, agents = run.states.shape
    times_s, events = run.times_s[:-1], len(problem.scene.events)
    words = {NONE: COVERS, ABSENT: AWAY, **{k: e.name for k, e in enumerate(problem.scene.events)}}
    states = np.array([words[state] for state in run.states.ravel().tolist()], dtype=np.str_)

    def by_agent(values: NDArray[Any], end: Any = np.nan) -> NDArray[Any]:
        """Return values (steps, agents) as one column, agent by agent; `end` pads missing steps."""
        missing = np.full((steps + 1 - len(values), agents), end, dtype=values.dtype)
        return np.concatenate((values, missing)).T.ravel()

    places = np.array([[e.place_at(t) for t in times_s.tolist()] for e in problem.scene.events])
    places = places.reshape(events, steps, 2)
    team = np.array([(run.states == k).sum(axis=1) for k in range(events)], dtype=np.int64)
    stds = run.stds_m.T.ravel()
    off_m = np.linalg.norm(run.beliefs_m - run.estimates_m[:, :, None], axis=3)
    own = run.states[:, None] == np.arange(events)[:, None]
    spread_m = np.where(own, off_m, -np.inf).max(axis=2, initial=-np.inf)
    numbers = np.array(range(steps + 1), dtype=np.int64)
    taken = np.concatenate((np.zeros((0, 4)), *run.readings))
    there = [[int(e.is_there(t)) for t in times_s.tolist()] for e in problem.scene.events]
    return {
        STEPS_FILE: {
            "robot": np.repeat([agent_name(number) for number in range(agents)], steps + 1),
            "step": np.repeat(numbers[None], agents, axis=0).ravel(),
            "t_s": np.repeat(run.times_s[None], agents, axis=0).ravel(),
            "x_m": by_agent(run.positions_m[..., 0]),
            "y_m": by_agent(run.positions_m[..., 1]),
            "vx_m_s": by_agent(run.velocities_m_s[..., 0]),
            "vy_m_s": by_agent(run.velocities_m_s[..., 1]),
            "heading_rad": by_agent(run.headings_rad),
            "state": by_agent(states.reshape(steps, agents), ""),
            "target_x_m": by_agent(run.targets_m[..., 0]),
            "target_y_m": by_agent(run.targets_m[..., 1]),
            "count": by_agent(run.counts),
        },
        NETWORK_FILE: {
            "step": numbers[:-1],
            "t_s": times_s,
            "cost": run.costs,
            "residual_m": run.residuals_m,
            "count_messages": run.messages[:, 0],
            "assignment_messages": run.messages[:, 1],
            "reading_messages": run.messages[:, 2],
        },
        EVENTS_FILE: {
            "event": np.repeat(
                np.array([e.name for e in problem.scene.events], dtype=np.str_), steps
            ),
            "step": np.repeat(numbers[None, :-1], events, axis=0).ravel(),
            "t_s": np.repeat(times_s[None], events, axis=0).ravel(),
            "there": np.array(there, dtype=np.int64).ravel(),
            "x_m": places[..., 0].ravel(),
            "y_m": places[..., 1].ravel(),
            "estimate_x_m": run.estimates_m[..., 0].T.ravel(),
            "estimate_y_m": run.estimates_m[..., 1].T.ravel(),
            "std_m": np.where(np.isfinite(stds), stds, np.nan),
            "readings": run.sources[..., 0].T.ravel(),
            "first_step": run.sources[..., 1].T.ravel(),
            "made_step": run.sources[..., 2].T.ravel(),
            "informed": np.isfinite(run.beliefs_m[..., 0]).sum(axis=2).T.ravel(),
            "spread_m": np.where(spread_m >= 0.0, spread_m, np.nan).T.ravel(),
            "wanted": run.wanted.T.ravel(),
            "responding": team.ravel(),
        },
        READINGS_FILE: {
            "event": np.repeat(
                np.array([e.name for e in problem.scene.events], dtype=np.str_),
                [len(rows) for rows in run.readings],
            ),
            "step": taken[:, 0].astype(np.int64),
            "x_m": taken[:, 1],
            "y_m": taken[:, 2],
            "signal": taken[:, 3],
        },
    }


def in_words(result: TaskResult) -> Sequence[str]:
    """Return a text summary of a deployment or run, line by line."""
    data, name = result.data, result.problem.name
    if "verdict" in data:
        bound = "no lower bound is proven"
        if data["bound"] is not None:
            bound = (
                f"proven bound: no deployment costs less than {data['bound']:.6g} m²; gap "
                f"{100.0 * data['gap']:.2f} % (method: Lagrangian relaxation)"
            )
        radio = cast("CoverageProblem", result.problem).radio is not None
        worst = max(data["start_costs"]) / data["objective"]
        return (
            f"{name}: {data['verdict']}, coverage cost {data['objective']:.6g} m² (integral of "
            "density times squared distance to the nearest agent)",
            f"  {bound}",
            f"  best of {STARTS} initial deployments; the worst of them leads to {worst:.4f} times "
            "this cost",
            *(("  solve ignores radio links; simulate keeps them connected",) if radio else ()),
        )
    found = data["metrics"]
    lines = [
        f"{name}: {data['outcome']} ({data['reason']}), planner {data['planner']}, "
        f"random seed {data['seed']}",
        f"  {found['steps']} steps; {len(data['robots'])} agents drove {found['path_m']:.1f} m in "
        "total",
        f"  coverage cost {found['cost_first']:.5g} m² at the start, {found['cost_last']:.5g} m² "
        "at the end (integral of density times squared distance to the nearest agent)",
    ]
    if found["messages"]["all"]:
        sent = found["messages"]
        lines.append(
            f"  {sent['all']} messages: {sent['counting']} to count agents, {sent['assignment']} "
            f"to assign them to events, {sent['readings']} with sensor readings; largest error "
            f"of an agent's count: {found['count_error_most']:g}"
        )
    for each in data["events"]:
        if each["detected_s"] is None:
            lines.append(f"  event {each['name']}: not detected")
            continue
        served = "never in place"
        if each["served_s"] is not None:
            served = f"in place at {each['served_s']:g} s"
        gone = "" if each["given_up_s"] is None else f", response ended at {each['given_up_s']:g} s"
        lines.append(
            f"  event {each['name']}: detected at {each['detected_s']:g} s; {each['responding']} "
            f"of {each['wanted']} required agents responded, {served}; position error "
            f"{each['error_m']:.3g} m{gone}"
        )
    return lines


def _figures(result: TaskResult) -> dict[str, Figure]:
    """Return the figure of a run or deployment."""
    from planopt.report import draw_deployment, draw_network

    problem = cast("CoverageProblem", result.problem)
    if isinstance(result.value, NetworkRun):
        return {RUN_PICTURE: draw_network(picture(result))}
    found = result.value
    shapes = tuple(each.polygon for each in problem.obstacles)
    return {
        PLAN_PICTURE: draw_deployment(
            problem.name, problem.scene.ground, shapes, found.places_m, found.cost
        )
    }


def _animate(result: TaskResult, path: Path) -> None:
    """Write an animation of a run."""
    from planopt.report import animate_network

    animate_network(picture(result), path)


def picture(result: TaskResult) -> NetworkPicture:
    """Return the data from which the figures of a run are drawn."""
    from planopt.report import NetworkPicture

    problem = cast("CoverageProblem", result.problem)
    shapes = tuple(each.polygon for each in problem.obstacles)
    return NetworkPicture(
        problem.name,
        result.value,
        problem.scene.ground,
        shapes,
        problem.scene.events,
        problem.radio,
    )


TASK = Task(
    model=CoverageFile,
    build=build,
    solve=solve,
    simulate=simulate,
    override=CoverageProblem.with_planner,
    controller=controller,
    verify=faults,
    reached=("settled", "served"),
    criterion=("cost_mean", "min"),
    summary=in_words,
    columns={
        STEPS_FILE: STEP_COLUMNS,
        NETWORK_FILE: NETWORK_COLUMNS,
        EVENTS_FILE: EVENT_COLUMNS,
        READINGS_FILE: READING_COLUMNS,
    },
    figures=_figures,
    animate=_animate,
    pictures=(RUN_PICTURE, PLAN_PICTURE),
    steps=lambda problem: round(
        problem.config.control.duration_s / problem.config.control.time_step_s
    ),
)
