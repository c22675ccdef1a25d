"""Report a simulated network as JSON, tables and words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.assignment import NONE
from planopt.coverage.control.laws import Gains
from planopt.coverage.limits import packing_reach_m
from planopt.coverage.simulation import ABSENT, NetworkRun
from planopt.files.tables import Column, Data, table_of_rows
from planopt.planning.files.record import finite
from planopt.systems.coverage.build import CoverageProblem

STEPS_FILE, NETWORK_FILE, EVENTS_FILE = "steps.csv", "network.csv", "events.csv"

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
    Column("assignment_messages", "messages for assignment", kind="count", required=True),
    Column("reading_messages", "messages with sensor readings", kind="count", required=True),
)
EVENT_COLUMNS = (
    Column("event", "name of the event", kind="text", required=True),
    Column("step", "number of the step", kind="count", required=True),
    Column("t_s", "time", "s", required=True),
    Column("there", "whether the event is there", kind="count", required=True),
    Column("x_m", "position of the event", "m", required=True),
    Column("y_m", "position of the event", "m", required=True),
    Column("estimate_x_m", "estimated position; empty before it is detected", "m"),
    Column("estimate_y_m", "estimated position; empty before it is detected", "m"),
    Column("std_m", "standard deviation of the estimate", "m"),
    Column("wanted", "number of agents wanted", kind="count", required=True),
    Column("responding", "number of agents that respond", kind="count", required=True),
)
COVERS, AWAY = "covers", "absent"
"""States of agents that respond to no event."""

ON_TARGET_M = 1e-9
"""Slack of the distance at which an agent has settled, for rounding in tables."""


@dataclass(frozen=True, eq=False)
class Driven:
    """A network that was simulated, with how."""

    problem: CoverageProblem  # What was asked for, and what happened
    run: NetworkRun
    planner: str  # By whom
    horizon: int
    seed: int

    @property
    def members(self) -> NDArray[np.bool_]:
        """Return which agents take part in each step; (T, n)."""
        return self.run.states != ABSENT


def agent_name(number: int) -> str:
    """Return what outputs call an agent."""
    return f"agent{number}"


def outcome(driven: Driven) -> tuple[str, str]:
    """Return ``settled``, ``served``, ``unserved`` or ``not_settled``, and why."""
    run, scene = driven.run, driven.problem
    last_s = float(run.times_s[-2])
    for entry in event_results(driven):
        if entry["appears_s"] > last_s:
            continue
        if entry["detected_s"] is None:
            return "unserved", f"{entry['name']} was not detected"
        if entry["served_s"] is None:
            return "unserved", f"{entry['name']} never had the agents it asks for in place"
    moving = any(any(each.velocity_m_s) and each.is_there(last_s) for each in scene.events)
    if run.settled:
        return "settled", f"after {_settled_s(driven):g} s"
    if moving:
        return "served", f"an event moves on at {last_s:g} s"
    due = (scene.joins_s <= last_s) & (last_s < scene.leaves_s)
    waiting = np.flatnonzero(due & (run.states[-1] == ABSENT))
    if len(waiting):
        return "not_settled", f"{agent_name(int(waiting[0]))} waits for room to join"
    return "not_settled", (
        f"an agent is {run.residuals_m[-1]:.3g} m from its target after {last_s:g} s, "
        f"settled is {driven.problem.settled_m:.3g} m"
    )


def run_json(driven: Driven) -> dict[str, Any]:
    """Return the JSON object of ``simulate``, wall times left out."""
    run = driven.run
    found, reason = outcome(driven)
    times_s = run.times_s.tolist()
    return {
        "horizon": driven.horizon,
        "planner": driven.planner,
        "seed": driven.seed,
        "outcome": found,
        "reason": reason,
        "metrics": metrics(driven),
        "rungs": {driven.planner: len(times_s) - 1},
        "events": event_results(driven),
        "robots": [
            {
                "name": agent_name(number),
                "t_s": times_s,
                "x_m": run.positions_m[:, number, 0].tolist(),
                "y_m": run.positions_m[:, number, 1].tolist(),
            }
            for number in range(run.positions_m.shape[1])
        ],
    }


def metrics(driven: Driven) -> dict[str, Any]:
    """Return the numbers of a run: cost, way, energy, messages, counts."""
    run = driven.run
    step_s = float(run.times_s[1] - run.times_s[0])
    driven_m = np.linalg.norm(np.diff(run.positions_m, axis=0), axis=2)
    members = driven.members
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
        "settled_s": _settled_s(driven),
        "path_m": float(driven_m.sum()),
        "energy_m2_s": float((driven_m**2).sum() / step_s),
        "messages": {**sent, "all": int(run.messages.sum())},
        "count_error_most": float(wrong.max()) if len(wrong) else 0.0,
    }


def event_results(driven: Driven) -> list[dict[str, Any]]:
    """Return when each event was detected, served and given up, and how well it was located."""
    run, problem, results = driven.run, driven.problem, list[dict[str, Any]]()
    times_s = run.times_s[:-1]
    near_m = problem.settled_m + ON_TARGET_M
    for number, event in enumerate(problem.events):
        known = np.isfinite(run.estimates_m[:, number, 0])
        there = np.array([event.is_there(time_s) for time_s in times_s.tolist()])
        team = run.states == number
        responding = team.sum(axis=1)
        in_place = (~team | _in_place(driven, number, near_m)).all(axis=1)
        wanted = run.wanted[:, number]
        served = known & there & in_place & (responding == wanted) & (wanted > 0)
        if any(event.velocity_m_s):
            served = known & there & (responding == wanted) & (wanted > 0)
        places = np.array([event.place_at(time_s) for time_s in times_s.tolist()])
        error_m = np.linalg.norm(run.estimates_m[:, number] - places, axis=1)
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


def _in_place(driven: Driven, number: int, near_m: float) -> NDArray[np.bool_]:
    """Return whether agents are where an event wants them; (T, n).

    They are within `near_m` of their targets. Bodies may also stand still, crowded around it.
    """
    run, problem, control = driven.run, driven.problem, driven.problem.given.control
    here = run.positions_m[:-1]
    in_place = np.linalg.norm(run.targets_m - here, axis=2) <= near_m
    body_m = problem.limits.body_radius_m
    if body_m == 0.0:
        return in_place
    gains = Gains(control.event_gain_per_s, control.coverage_gain_per_s)
    share = float(gains.shares(np.array([True]), control.time_step_s)[0])
    still = np.linalg.norm(np.diff(run.positions_m, axis=0), axis=2) <= share * near_m
    off_m = np.linalg.norm(here - run.estimates_m[:, number, None], axis=2)
    team = (run.states == number).sum(axis=1).tolist()
    reach_m = np.array([packing_reach_m(agents, body_m) for agents in team])
    reach_m += near_m + (problem.stand_off_m or 0.0)
    return in_place | (still & (off_m <= reach_m[:, None]))


def tables_of(driven: Driven) -> dict[str, tuple[Sequence[Column], Data]]:
    """Return columns and data of ``steps.csv``, ``network.csv`` and ``events.csv``."""
    return {
        STEPS_FILE: (STEP_COLUMNS, table_of_rows(STEP_COLUMNS, _step_rows(driven))),
        NETWORK_FILE: (NETWORK_COLUMNS, table_of_rows(NETWORK_COLUMNS, _network_rows(driven))),
        EVENTS_FILE: (EVENT_COLUMNS, table_of_rows(EVENT_COLUMNS, _event_rows(driven))),
    }


def in_words(name: str, data: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a run in lines of text."""
    found = data["metrics"]
    lines = [
        f"{name}: {data['outcome']} ({data['reason']}), planner {data['planner']}, "
        f"seed {data['seed']}",
        f"  {found['steps']} steps, {len(data['robots'])} agents drove {found['path_m']:.1f} m; "
        f"coverage cost {found['cost_first']:.5g} to {found['cost_last']:.5g}",
    ]
    if found["messages"]["all"]:
        sent = found["messages"]
        lines.append(
            f"  {sent['all']} messages: {sent['counting']} for counting, {sent['assignment']} for "
            f"assignment, {sent['readings']} readings; the count was off by at most "
            f"{found['count_error_most']:g}"
        )
    for each in data["events"]:
        if each["detected_s"] is None:
            lines.append(f"  {each['name']}: not detected")
            continue
        served = "never" if each["served_s"] is None else f"{each['served_s']:g} s"
        gone = "" if each["given_up_s"] is None else f", given up at {each['given_up_s']:g} s"
        lines.append(
            f"  {each['name']}: detected at {each['detected_s']:g} s, agents in place {served}, "
            f"{each['responding']} of {each['wanted']} wanted, located within "
            f"{each['error_m']:.3g} m{gone}"
        )
    return tuple(lines)


def _settled_s(driven: Driven) -> float | None:
    """Return from when on all agents were settled until the end; None if they are not."""
    run = driven.run
    if not run.settled:
        return None
    off = np.flatnonzero(run.residuals_m > driven.problem.settled_m + ON_TARGET_M)
    return float(run.times_s[off[-1] + 1]) if len(off) else 0.0


def _first_s(times_s: NDArray[np.float64], which: NDArray[np.bool_]) -> float | None:
    return float(times_s[which.argmax()]) if which.any() else None


def state_names(problem: CoverageProblem) -> dict[int, str]:
    """Return the word for each state of an agent."""
    return {NONE: COVERS, ABSENT: AWAY, **{k: e.name for k, e in enumerate(problem.events)}}


def _step_rows(driven: Driven) -> Iterator[tuple[object, ...]]:
    run, words = driven.run, state_names(driven.problem)
    steps, agents = run.states.shape
    for number in range(agents):
        places, targets = run.positions_m[:, number].tolist(), run.targets_m[:, number].tolist()
        ways = run.velocities_m_s[:, number].tolist()
        turned = run.headings_rad[:, number].tolist()
        counts, states = run.counts[:, number].tolist(), run.states[:, number].tolist()
        for step, time_s in enumerate(run.times_s.tolist()):
            head = (agent_name(number), step, time_s, *places[step], *ways[step], turned[step])
            if step == steps:
                yield (*head, "", "", "", "")
                continue
            count = "" if states[step] == ABSENT else counts[step]
            yield (*head, words[states[step]], *targets[step], count)


def _network_rows(driven: Driven) -> Iterator[tuple[object, ...]]:
    run = driven.run
    columns = (run.costs.tolist(), run.residuals_m.tolist(), run.messages.tolist())
    for step, (cost, residual, sent) in enumerate(zip(*columns, strict=True)):
        yield (step, float(run.times_s[step]), cost, residual, *sent)


def _event_rows(driven: Driven) -> Iterator[tuple[object, ...]]:
    run = driven.run
    for number, event in enumerate(driven.problem.events):
        for step, time_s in enumerate(run.times_s[:-1].tolist()):
            known = bool(np.isfinite(run.estimates_m[step, number, 0]))
            guess = run.estimates_m[step, number].tolist() if known else ["", ""]
            std = float(run.stds_m[step, number])
            yield (
                event.name,
                step,
                time_s,
                int(event.is_there(time_s)),
                *event.place_at(time_s).tolist(),
                *guess,
                std if np.isfinite(std) else "",
                int(run.wanted[step, number]),
                int((run.states[step] == number).sum()),
            )
