"""Judge a saved run of a network from its files: moves, targets, teams, estimates and numbers.

Moves are judged by the outline, the obstacles and the speeds alone; targets and costs by dividing
the region again; then everything that the JSON file says is computed again from the tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.coverage.assignment import demanded
from planopt.coverage.control.laws import Gains, coverage_aims
from planopt.coverage.control.movers import Motion
from planopt.coverage.events import event_places
from planopt.coverage.optima import cost_bound
from planopt.coverage.simulation import ABSENT, NetworkRun, residual_m
from planopt.coverage.verify import verify_moves
from planopt.errors import InputError
from planopt.files.compare import differences, in_words
from planopt.files.tables import Data, comparable, read_table
from planopt.files.typed_json import whole_number
from planopt.problems.systems import SystemProblem
from planopt.systems.coverage.build import CoverageProblem, overlapping
from planopt.systems.coverage.results import (
    EVENT_COLUMNS,
    EVENTS_FILE,
    NETWORK_COLUMNS,
    NETWORK_FILE,
    STEP_COLUMNS,
    STEPS_FILE,
    Driven,
    agent_name,
    run_json,
    state_names,
    tables_of,
)
from planopt.systems.coverage.tables import has_room

PLACE_M = 1e-6
"""Places that are computed again agree to this."""

COST_SHARE = 1e-6
"""Coverage costs that are computed again agree to this share."""


def faults(driven: Driven) -> list[str]:
    """Return what is wrong with the moves of a run; nothing if every move is allowed."""
    run, problem = driven.run, driven.problem
    world, limits = problem.given.world, problem.limits
    moving = (run.positions_m, run.velocities_m_s, run.headings_rad)
    if not all(np.isfinite(each).all() for each in moving):
        return [f"{STEPS_FILE}: a place, velocity or heading is not finite"]
    free = shapely.box(*world.bounds_m) if world.bounds_m else shapely.Polygon(world.outline_m)
    for obstacle in problem.obstacles:
        free = free.difference(obstacle.polygon)
    reasons = list[str]()
    for step in range(len(run.costs)):
        who = np.flatnonzero(run.states[step] != ABSENT)
        both = [(each[step, who], each[step + 1, who]) for each in moving]
        found = verify_moves(
            cast("shapely.Polygon", free),
            *both[0],
            limits,
            velocities_m_s=both[1],
            headings_rad=both[2],
            radio=problem.radio,
        )
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
    return reasons


def check(file: Path, data: Mapping[str, Any], problem: SystemProblem) -> list[str]:
    """Return what is wrong with a saved run; nothing if it holds."""
    content: CoverageProblem = problem.content
    if "objective" in data:
        return _deployment(file, data, content)
    seed, horizon = whole_number(file, data, "seed"), whole_number(file, data, "horizon")
    run, tables = _read(file.parent, content, seed)
    driven = Driven(content, run, str(data.get("planner")), horizon, seed)
    moved = faults(driven)
    if moved:
        # The region cannot be divided among places outside it.
        return moved
    reasons = [*_starts(driven), *_targets(driven), *_events(driven)]
    kept = {key: data.get(key) for key in ("wall_s", "step_s", "problem_file")}
    found = {
        "problem": problem.name,
        **run_json(driven),
        **{"faults": moved, "verified_rate": 1.0},
        **kept,
    }
    for name, (_, table) in tables_of(driven).items():
        reasons += in_words(name, differences(comparable(tables[name]), comparable(table)))
    return reasons + in_words(file.name, differences(data, found))


def deployment_json(
    problem: CoverageProblem, places_m: NDArray[np.float64], bound: float
) -> dict[str, Any]:
    """Return what a solution says of a deployment: verdict, cost, bound and places."""
    body_m = problem.limits.body_radius_m
    fine = bool(has_room(problem.ground, places_m, body_m).all())
    fine &= overlapping(places_m, body_m) is None
    cost = problem.ground.cover(places_m).cost
    return {
        "verdict": "verified" if fine and bound <= cost * (1.0 + COST_SHARE) else "violated",
        "sense": "min",
        "objective": cost,
        "bound": bound if bound > 0.0 else None,
        "gap": (cost - bound) / max(cost, 1e-12) if bound > 0.0 else None,
        "robots": [
            {"name": agent_name(number), "t_s": [0.0], "x_m": [x], "y_m": [y]}
            for number, (x, y) in enumerate(places_m.tolist())
        ],
    }


def _deployment(file: Path, data: Mapping[str, Any], problem: CoverageProblem) -> list[str]:
    """Return what is wrong with a saved solution: its places, cost and bound are computed again."""
    robots = data.get("robots")
    try:
        places = np.array([[one["x_m"][0], one["y_m"][0]] for one in cast("Any", robots)])
        places = places.astype(np.float64)
    except (TypeError, KeyError, IndexError, ValueError):
        raise InputError("has not one place for each agent", file=file, key="robots") from None
    if places.shape != (len(problem.joins_s), 2) or not np.isfinite(places).all():
        raise InputError("has not one place for each agent", file=file, key="robots")
    if not problem.ground.allows(places).all():
        return [f"{file.name}: an agent is where none may be"]
    found = deployment_json(problem, places, cost_bound(problem.ground, len(places)))
    kept = {key: value for key, value in data.items() if key not in found}
    return in_words(file.name, differences(data, {**kept, **found}))


def _targets(driven: Driven) -> list[str]:
    """Covering agents drive to their centroids, and the cost is that of the places."""
    run, problem = driven.run, driven.problem
    control, reasons = problem.given.control, list[str]()
    for step in range(len(run.costs)):
        who = np.flatnonzero(run.states[step] != ABSENT)
        agents, responds = run.positions_m[step, who], run.states[step, who] >= 0
        aims = coverage_aims(problem.ground, agents, responds, control.partition)
        cost = aims.cost
        if control.partition == "coverage_only" and responds.any():
            cost = coverage_aims(problem.ground, agents, np.zeros_like(responds)).cost
        if abs(cost - run.costs[step]) > COST_SHARE * cost:
            reasons.append(f"{NETWORK_FILE}: step {step}: the coverage cost is {cost:.9g}")
        off_m = np.linalg.norm(aims.targets_m - run.targets_m[step, who], axis=1)[~responds]
        if len(off_m) and off_m.max() > PLACE_M:
            agent = agent_name(int(who[~responds][off_m.argmax()]))
            reasons.append(
                f"{STEPS_FILE}: {agent} covers, and its target in step {step} is {off_m.max():.3g} "
                "m off its centroid"
            )
        now, after = (
            Motion(run.positions_m[at, who], run.velocities_m_s[at, who], run.headings_rad[at, who])
            for at in (step, step + 1)
        )
        gains = Gains(control.event_gain_per_s, control.coverage_gain_per_s)
        away_m = residual_m(
            gains, control.time_step_s, now, after, run.targets_m[step, who], responds
        )
        if abs(away_m - run.residuals_m[step]) > PLACE_M:
            reasons.append(f"{NETWORK_FILE}: step {step}: the residual is {away_m:.6g} m")
        if driven.planner == "law":
            reasons += _law(driven, step)
        if len(reasons) > 5:
            break
    return reasons


def _law(driven: Driven, step: int) -> list[str]:
    """Agents move by their gain's share of the way to the target, or as fast as they may."""
    run, given = driven.run, driven.problem.given
    control, here = given.control, run.positions_m[step]
    gain = np.where(run.states[step] >= 0, control.event_gain_per_s, control.coverage_gain_per_s)
    way = run.targets_m[step] - here
    length = np.linalg.norm(way, axis=1)
    share = gain * control.time_step_s
    if given.agents.speed_max_m_s is not None:
        most_m = given.agents.speed_max_m_s * control.time_step_s
        share = np.minimum(share, most_m / np.maximum(length, 1e-300))
    wanted = here + np.where(run.states[step] == ABSENT, 0.0, share)[:, None] * way
    off_m = np.linalg.norm(wanted - run.positions_m[step + 1], axis=1)
    if off_m.max() > PLACE_M:
        name = agent_name(int(off_m.argmax()))
        return [f"{STEPS_FILE}: {name} is {off_m.max():.3g} m off the law after step {step}"]
    return []


def _events(driven: Driven) -> list[str]:
    """Check that agents respond to known events, and that the demand is right."""
    run, problem, reasons = driven.run, driven.problem, list[str]()
    control = problem.given.control
    share = min(control.event_gain_per_s * control.time_step_s, 1.0)
    for number, event in enumerate(problem.events):
        known = np.isfinite(run.estimates_m[:, number, 0])
        lonely = np.flatnonzero((run.states == number).any(axis=1) & ~known)
        if len(lonely):
            reasons.append(
                f"{STEPS_FILE}: step {lonely[0]}: nobody knows {event.name}, agents respond"
            )
        for step in np.flatnonzero(known).tolist():
            team = run.positions_m[step, run.states[step] == number]
            if len(team):
                body_m = problem.limits.body_radius_m
                place = run.estimates_m[step, number]
                ends = event_places(team, place, problem.stand_off_m, body_m)
                aims = problem.ground.steered(team, problem.ground.nearest(ends), share)
                off_m = np.linalg.norm(
                    aims - run.targets_m[step, run.states[step] == number], axis=1
                )
                if off_m.max() > PLACE_M:
                    reasons.append(
                        f"{STEPS_FILE}: step {step}: who responds to {event.name} has a target "
                        f"{off_m.max():.3g} m off the estimate"
                    )
                    break
            who = np.flatnonzero(run.states[step] != ABSENT)
            away = np.linalg.norm(
                run.positions_m[step, who] - run.estimates_m[step, number], axis=1
            )
            believed = run.counts[step, who][int(away.argmin())]
            asked = demanded(problem.demands[number], round(believed))
            if asked != run.wanted[step, number]:
                reasons.append(
                    f"{EVENTS_FILE}: step {step}: {event.name} asks for {asked} agents, not "
                    f"{run.wanted[step, number]}"
                )
                break
    return reasons


def _starts(driven: Driven) -> list[str]:
    """Agents start where the problem or the seed says."""
    scene = driven.problem.scene(np.random.default_rng(driven.seed))
    off_m = np.linalg.norm(scene.starts_m - driven.run.positions_m[0], axis=1)
    if off_m.max() > PLACE_M:
        return [f"{STEPS_FILE}: {agent_name(int(off_m.argmax()))} starts somewhere else"]
    return []


def _read(folder: Path, problem: CoverageProblem, seed: int) -> tuple[NetworkRun, dict[str, Data]]:
    """Return the run in the tables of a folder, and these."""
    agents, events = len(problem.joins_s), len(problem.events)
    columns = {
        STEPS_FILE: STEP_COLUMNS,
        NETWORK_FILE: NETWORK_COLUMNS,
        EVENTS_FILE: EVENT_COLUMNS,
    }
    tables: dict[str, Data] = {
        name: read_table(folder / name, own) for name, own in columns.items()
    }
    rows, network, told = (tables[name] for name in columns)
    steps = len(network["step"])
    sizes = (
        (STEPS_FILE, len(rows["step"]), agents * (steps + 1)),
        (EVENTS_FILE, len(told["step"]), events * steps),
    )
    for name, count, wanted in sizes:
        if count != wanted or not steps:
            raise InputError(f"has {count} rows, not {wanted}", file=folder / name)

    def by_agent(*names: str, before_end: bool = True) -> NDArray[Any]:
        found = np.stack([rows[name] for name in names], axis=-1)
        found = found.reshape(agents, steps + 1, len(names)).transpose(1, 0, 2)
        return found[:-1] if before_end else found

    words = {word: state for state, word in state_names(problem).items()}
    said = by_agent("state")[..., 0]
    if not np.isin(said, list(words)).all():
        raise InputError("has an unknown state", file=folder / STEPS_FILE, key="state")
    targets_m = by_agent("target_x_m", "target_y_m")
    if not np.isfinite(targets_m).all():
        raise InputError("has no target", file=folder / STEPS_FILE, key="target_x_m")
    times_s = rows["t_s"][: steps + 1]
    if np.abs(times_s - np.arange(steps + 1) * problem.given.control.time_step_s).max() > PLACE_M:
        raise InputError("are not control.time_step_s apart", file=folder / STEPS_FILE, key="t_s")

    def by_event(*names: str) -> NDArray[Any]:
        found = np.stack([told[name] for name in names], axis=-1)
        return found.reshape(events, steps, len(names)).transpose(1, 0, 2)

    estimates_m, stds = by_event("estimate_x_m", "estimate_y_m"), by_event("std_m")[..., 0]
    states = np.vectorize(words.__getitem__, otypes=[np.intp])(said)
    scene = problem.scene(np.random.default_rng(seed))
    settled = scene.has_settled(
        float(times_s[-2]),
        float(network["residual_m"][-1]),
        np.isfinite(estimates_m[-1, :, 0]),
        states[-1] != ABSENT,
    )
    messages = ("count_messages", "assignment_messages", "reading_messages")
    run = NetworkRun(
        times_s,
        by_agent("x_m", "y_m", before_end=False),
        by_agent("vx_m_s", "vy_m_s", before_end=False),
        by_agent("heading_rad", before_end=False)[..., 0],
        states,
        targets_m,
        network["cost"],
        network["residual_m"],
        by_agent("count")[..., 0],
        by_event("wanted")[..., 0].astype(np.intp),
        estimates_m,
        np.where(np.isfinite(estimates_m[..., 0]) & np.isnan(stds), np.inf, stds),
        np.stack([network[name] for name in messages], axis=1).astype(np.intp),
        settled,
    )
    return run, tables
