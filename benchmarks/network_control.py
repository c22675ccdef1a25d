"""Constrained control of networks in numbers: faults, horizons, optima and step times.

``python benchmarks/network_control.py faults --runs 100`` moves 50 agents with active limits and
has every move verified. ``failures`` loses messages and agents and lets a sensor stick, ``horizons
--seeds 8`` compares horizons on the same starts, ``moving`` horizons with an event that moves,
``packing`` how tightly bodies end around one place, ``optima --scenes 20`` several starts with the
best of 50 runs of Lloyd's method, and ``steps --agents 1000`` measures a step against the Voronoi
diagram of the same places. All take ``--first-seed``.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from time import process_time

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.stats import binomtest, t

from planopt import simulate
from planopt.coverage import (
    ABSENT,
    UNBOUNDED,
    ConvexGround,
    GaussianMixture,
    Ground,
    LinkLaw,
    Motion,
    MoveLimits,
    RadioLimits,
    UniformDensity,
    best_deployment,
    braking_offsets_m,
    convex_region,
    cost_bound,
    foreseen_aims,
    geodesic_ground,
    packed_places,
    packing_reach_m,
    plan_moves,
    radio_tree,
    signals,
    verify_moves,
)
from planopt.problems.tasks import problem_from
from planopt.tasks.coverage import controller

SIDE_M = 100.0
GAIN = 0.5
AHEAD = 5
MOST_LLOYD_STEPS = 500
LINK = LinkLaw(np.array([-10.0, 2.5]), 6.0, np.diag([1.0, 0.01]))
RADIO = RadioLimits(np.array([[5.0, 5.0]]), LINK, LINK, -50.0, 0.9)
KINDS = ({}, {}, {}, {"acceleration_m_s2": 1.0}, {"turn_rate_rad_s": 1.0})


def drive(
    ground: Ground,
    free: shapely.Polygon,
    agents: NDArray[np.float64],
    limits: MoveLimits,
    horizon: int,
    steps: int,
    radio: RadioLimits | None,
    event: NDArray[np.float64] | None = None,
    event_m_s: NDArray[np.float64] | None = None,
    lead: bool = False,
) -> dict[str, float]:
    """Drive agents, verify every move, and sum up; a third of them drives to the event.

    The event may move; plans hold its place over the horizon, or lead it.
    """
    motion, inert = Motion.at_rest(agents), limits.acceleration_m_s2
    sums = dict.fromkeys(("cost", "path", "energy", "faults", "final", "lag"), 0.0)
    for _ in range(steps):
        here = motion.places_m
        cover = ground.cover(here)
        targets, drifts = cover.targets_m.copy(), np.zeros_like(here)
        if event is not None:
            third = len(here) // 3
            aims = np.tile(event, (third, 1))
            targets[:third] = ground.steered(here[:third], aims, GAIN)
            if event_m_s is not None:
                drifts[:third] = event_m_s
                event = event + limits.time_step_s * event_m_s
        kept = UNBOUNDED
        if radio is not None:
            speeds = motion.velocities_m_s
            stops = here if inert is None else here + braking_offsets_m(speeds, inert)
            kept = radio_tree(here, radio, stops).kept
        after = plan_moves(
            ground, motion, targets, limits, GAIN, horizon, kept=kept,
            drifts_m_s=drifts if lead else None,
        ).motion  # fmt: skip
        sums["faults"] += len(verify_moves(free, motion, after, limits, radio))
        sums["cost"] += cover.cost / steps
        sums["path"] += float(np.linalg.norm(after.places_m - here, axis=1).sum())
        sums["energy"] += float(((after.velocities_m_s - motion.velocities_m_s) ** 2).sum())
        if event is not None:
            off = np.linalg.norm(after.places_m[: len(here) // 3] - event, axis=1)
            sums["lag"] += float(off.mean()) / steps
        motion = after
    return sums | {"final": ground.cover(motion.places_m).cost}


def spread(count: int, width_m: float, generator: np.random.Generator) -> NDArray[np.float64]:
    """Places (n, 2) in a corner of the hall, apart from each other."""
    side = int(np.ceil(np.sqrt(count)))
    step = width_m / side
    at = 3.0 + step * np.arange(side)
    grid = np.stack(np.meshgrid(at, at), axis=2).reshape(-1, 2)[:count]
    return grid + 0.3 * step * generator.random((count, 2))


def hall(generator: np.random.Generator) -> Ground:
    """A square with two obstacles away from the corner."""
    low = 45.0 + 20.0 * generator.random((2, 2))
    low[1] = [70.0, 15.0] + 10.0 * generator.random(2)
    walls = [shapely.box(x, y, x + 12.0, y + 18.0) for x, y in low]
    return geodesic_ground(shapely.box(0, 0, SIDE_M, SIDE_M), walls, 4.0, clearance_m=1.0)


def faults(first_seed: int, runs: int, agents: int, steps: int) -> float:
    """Print how many moves were found at fault; return the number."""
    total = 0.0
    for seed in range(first_seed, first_seed + runs):
        generator = np.random.default_rng(seed)
        ground = hall(generator)
        limits = MoveLimits(
            speed_m_s=3.0, body_radius_m=0.8, clearance_m=1.0, **KINDS[seed % len(KINDS)]
        )
        start = spread(agents, 36.0, generator)
        event = 30.0 + 60.0 * generator.random(2)
        sums = drive(ground, ground.free, start, limits, 8, steps, RADIO, event)  # type: ignore[attr-defined]
        total += sums["faults"]
        print(f"seed {seed}: {total:.0f} faults so far", flush=True)
    return total


LOST = {
    "problem": {"schema": 1, "name": "lost", "task": "coverage"},
    "world": {"bounds_m": [0, 0, 60, 50]},
    "events": [
        {
            "name": "leak",
            "place_m": [40, 30],
            "appears_s": 15,
            "ends_s": 45,
            "demand": {"kind": "number", "agents": 3},
        }
    ],
    "sensor": {"strength": 60.0, "noise_std": 0.5, "scale_m": 3.0},
    "links": {"k_pl_db": -30, "n_pl": 3.0, "fading_std_db": 6.0, "threshold_dbm": -71},
    "control": {"coverage_gain_per_s": 1.0, "duration_s": 90, "stop_when_settled": False},
    "planner": {"name": "deploy", "horizon": 3},
}
QUIET, STUCK = "stuck at no signal", "stuck at the last signal"


def failures(first_seed: int, runs: int, agents: int) -> dict[str, list[float]]:
    """Print contacts, and last costs over those of the best deployment of the remaining agents.

    About a fifth of all messages is lost, two agents are lost for good, and one sensor sticks.
    Sensors are counted as excluded if some agent excludes them.
    """
    ratios: dict[str, list[float]] = {QUIET: [], STUCK: []}
    contacts, found_faulty, wrongly = 0, {QUIET: 0, STUCK: 0}, 0
    for seed in range(first_seed, first_seed + runs):
        generator = np.random.default_rng(seed)
        numbers = generator.permutation(agents)
        kind = (QUIET, STUCK)[seed % 2]
        tables = {
            **LOST,
            "agents": {
                "start": {"kind": "random", "count": agents, "within_m": [2, 2, 30, 30]},
                "speed_max_m_s": 3.0,
                "body_radius_m": 0.4,
            },
            "changes": [
                {"agents": [agent], "leaves_s": float(time_s)}
                for agent, time_s in zip(numbers[:2].tolist(), (8.0, 30.0), strict=True)
            ],
        }
        problem = problem_from(tables, folder=Path(), file=None)
        network, scene = controller(problem, seed=seed), problem.scene
        begins, broken, stuck = 20 + seed % 20, int(numbers[2]), 0.0
        left = np.sort(numbers[2:])
        for step in range(90):
            now = network.motion
            signal = signals(scene.events[0], scene.sensing, now.places_m, float(step), generator)
            if step < begins:
                stuck = float(signal[broken]) if kind == STUCK else 0.0
            else:
                signal[broken] = stuck
            decided = network.step(readings=signal[None])
            there = decided.states != ABSENT
            before, after = (
                Motion(each.places_m[there], each.velocities_m_s[there], each.headings_rad[there])
                for each in (now, decided.motion)
            )
            contacts += len(verify_moves(scene.ground.free, before, after, problem.config.limits))
        excluded = set(np.flatnonzero(decided.beliefs[0].excluded.any(axis=0)).tolist())
        found_faulty[kind] += broken in excluded
        wrongly += len(excluded - {broken})
        last = scene.ground.cover(network.motion.places_m[left]).cost
        best = best_deployment(scene.ground, len(left), 5, generator).cost
        ratios[kind].append(last / best)
        found = np.array(ratios[kind])
        print(
            f"seed {seed}: {contacts} faults of moves; {kind}: {(found <= 1.1).sum()} of "
            f"{len(found)} within 10 %, median {np.median(found):.3f}, largest {found.max():.3f}; "
            f"{found_faulty[kind]} excluded, and {wrongly} sound sensors",
            flush=True,
        )
    for kind, each in ratios.items():
        if not each:
            continue
        good = int((np.array(each) <= 1.1).sum())
        exact = binomtest(good, len(each)).proportion_ci(method="exact")
        print(f"{kind}: {good} of {len(each)}, {exact.low:.3f} to {exact.high:.3f} (95 %)")
    assert contacts == 0
    return ratios


MOVING = {
    "speed": MoveLimits(speed_m_s=2.0),
    "acceleration": MoveLimits(speed_m_s=2.0, acceleration_m_s2=0.4),
}


def moving(first_seed: int, seeds: int, agents: int, steps: int) -> dict[str, list[float]]:
    """Print how far teams are from a moving event by horizon, over horizon 1 with it held."""
    found: dict[str, list[float]] = {}
    square = shapely.box(0, 0, SIDE_M, SIDE_M)
    for name, limits in MOVING.items():
        rows: dict[tuple[bool, int], list[list[float]]] = {}
        for seed in range(first_seed, first_seed + seeds):
            generator = np.random.default_rng(seed)
            ground = ConvexGround(convex_region(square))
            start = SIDE_M * (0.05 + 0.9 * generator.random((agents, 2)))
            turn = 2.0 * np.pi * generator.random()
            velocity = 1.2 * np.array([np.cos(turn), np.sin(turn)])
            event = 0.5 * SIDE_M - 0.5 * steps * velocity
            start = start[np.argsort(np.linalg.norm(start - event, axis=1))]
            for lead in (False, True):
                for horizon in (1, 3, 10):
                    sums = drive(
                        ground, square, start, limits, horizon, steps, None, event, velocity, lead
                    )
                    keys = ("lag", "cost", "path", "energy")
                    rows.setdefault((lead, horizon), []).append([sums[key] for key in keys])
        one = np.array(rows[False, 1])
        print(f"{name}: lag {one[:, 0].mean():.2f} m at N = 1, held", flush=True)
        for (lead, horizon), values in rows.items():
            ratio = np.array(values) / one
            mean = ratio.mean(axis=0)
            error = t.ppf(0.975, seeds - 1) * ratio.std(axis=0, ddof=1) / np.sqrt(seeds)
            words = ", ".join(
                f"{key} {m:.3f} +- {e:.3f}"
                for key, m, e in zip(("lag", "H", "path", "energy"), mean, error, strict=True)
            )
            print(f"  {'led' if lead else 'held'}, N = {horizon}: {words}", flush=True)
            found[f"{name} {'led' if lead else 'held'} {horizon}"] = mean.tolist()
    return found


CIRCLE = {3: 2.1547, 5: 2.7013, 7: 3.0, 12: 4.0296}
"""Radii of the least circles that hold so many discs of radius 1 (Graham 1968; Fodor 2000)."""


def packing(first_seed: int, seeds: int, steps: int, packed: bool = True) -> dict[str, list[float]]:
    """Print how tightly teams of bodies end around a place that all of them want.

    Distances are of the outermost body's middle, in units of that of the tightest packing in a
    circle; in place are runs whose outermost body is within `packing_reach_m`.
    """
    found: dict[str, list[float]] = {}
    square, body = shapely.box(0, 0, SIDE_M, SIDE_M), 1.0
    ground = ConvexGround(convex_region(square))
    limits = MoveLimits(speed_m_s=2.0, body_radius_m=body, clearance_m=body)
    for count, radius in CIRCLE.items():
        ratios: list[float] = []
        for seed in range(first_seed, first_seed + seeds):
            generator = np.random.default_rng(seed)
            places = 5.0 + 90.0 * generator.random((20 * count, 2))
            chosen: list[int] = []
            for number, place in enumerate(places):
                if len(chosen) < count and all(
                    np.linalg.norm(place - places[one]) > 3.0 * body for one in chosen
                ):
                    chosen.append(number)
            motion, middle = Motion.at_rest(places[chosen]), np.full((count, 2), 0.5 * SIDE_M)
            for _ in range(steps):
                aims = packed_places(motion.places_m, middle[0], body) if packed else middle
                after = plan_moves(ground, motion, aims, limits, GAIN, 5).motion
                assert not verify_moves(square, motion, after, limits)
                motion = after
            away = np.linalg.norm(motion.places_m - middle, axis=1).max()
            ratios.append(float(away / ((radius - 1.0) * body)))
        table = np.array(ratios)
        reach = packing_reach_m(count, body) / ((radius - 1.0) * body)
        share = float((table <= reach).mean())
        print(
            f"{count} bodies: outermost at {np.median(table):.2f} (median), {table.max():.2f} "
            f"(largest) of the tightest packing; in place {share:.0%} of {seeds} (allowed "
            f"{reach:.2f})",
            flush=True,
        )
        found[str(count)] = [float(np.median(table)), float(table.max()), share]
    return found


SPREAD = {
    "problem": {"schema": 1, "name": "spread", "task": "coverage"},
    "world": {"bounds_m": [0, 0, SIDE_M, 80]},
    "control": {"coverage_gain_per_s": 1.0, "stop_when_settled": False},
    "planner": {"name": "receding"},
}
INERTIA = {"speed": {}, "acceleration": {"acceleration_max_m_s2": 0.25}}
HORIZONS = (1, 2, 5, 10)


def horizons(
    first_seed: int, seeds: int, agents: int, seconds: int, only: str | None = None
) -> dict[str, list[float]]:
    """Print cost, time and energy of horizons over those of one step, with Student intervals.

    Agents spread from a random box in a corner. The time is that after which the cost stays within
    5 % of its last value; the energy is that of velocities, or with inertia of accelerations.
    """
    found: dict[str, list[float]] = {}
    keys = ("cost", "last cost", "time", "energy")
    for name, limits in INERTIA.items():
        if only not in (None, name):
            continue
        rows: dict[int, list[list[float]]] = {}
        for seed in range(first_seed, first_seed + seeds):
            side = 10.0 + 20.0 * np.random.default_rng(seed).random(2)
            start = {"kind": "random", "count": agents, "within_m": [0, 0, *side.tolist()]}
            table = {"start": start, "speed_max_m_s": 2.0, **limits}
            control = {**SPREAD["control"], "duration_s": seconds}
            tables = {**SPREAD, "agents": table, "control": control}
            problem = problem_from(tables, folder=Path(), file=None)
            for horizon in HORIZONS:
                result = simulate(problem, seed=seed, horizon=horizon)
                assert result.data["faults"] == []
                costs, moves = result.value.costs, result.value.velocities_m_s
                late = np.flatnonzero(costs > 1.05 * costs[-1])
                energy = float((np.diff(moves, axis=0) ** 2 if limits else moves**2).sum())
                after = float(late[-1] + 1 if len(late) else 0)
                rows.setdefault(horizon, []).append([costs.mean(), costs[-1], after, energy])
        one = np.array(rows[1])
        print(f"{name}: within 5 % after {one[:, 2].mean():.0f} s at N = 1, {seeds} scenes")
        for horizon in HORIZONS[1:]:
            ratio = np.array(rows[horizon]) / one
            mean = ratio.mean(axis=0)
            error = t.ppf(0.975, seeds - 1) * ratio.std(axis=0, ddof=1) / np.sqrt(seeds)
            words = zip(keys, mean, error, strict=True)
            shown = ", ".join(f"{key} {m:.3f} +- {e:.3f}" for key, m, e in words)
            print(f"  N = {horizon} over N = 1: {shown}", flush=True)
            found[f"{name} {horizon}"] = mean.tolist()
    return found


def optima(first_seed: int, scenes: int, lloyd_runs: int) -> list[float]:
    """Print the cost of ten starts over that of the best of many runs of Lloyd's method."""
    ratios: list[float] = []
    for seed in range(first_seed, first_seed + scenes):
        generator = np.random.default_rng(seed)
        hull = shapely.convex_hull(shapely.multipoints(SIDE_M * generator.random((7, 2))))
        density = UniformDensity()
        if seed % 4 == 0:
            means = SIDE_M * (0.2 + 0.6 * generator.random((2, 2)))
            density = GaussianMixture(np.ones(2), means, np.full(2, 30.0), 1e-5)
        ground = ConvexGround(convex_region(hull), density)
        count = int(generator.integers(6, 17))
        costs: list[float] = []
        while len(costs) < lloyd_runs:
            low, high = np.array(hull.bounds[:2]), np.array(hull.bounds[2:])
            drawn = low + (high - low) * generator.random((20 * count, 2))
            costs.append(lloyd(ground, drawn[ground.allows(drawn)][:count]))
        best = best_deployment(ground, count, 10, generator)
        ratios.append(best.cost / min(costs))
        print(
            f"scene {seed}, {count} agents: {ratios[-1]:.4f} of the best, "
            f"{best.costs.min() / min(costs):.4f} before agents are moved, "
            f"median run {np.median(costs) / min(costs):.4f}, "
            f"lower bound {cost_bound(ground, best.places_m) / best.cost:.3f}; "
            f"largest so far {max(ratios):.4f}",
            flush=True,
        )
    return ratios


def lloyd(ground: Ground, places: NDArray[np.float64]) -> float:
    """The cost at which Lloyd's method stops."""
    here = ground.cover(places)
    for _ in range(MOST_LLOYD_STEPS):
        there = ground.cover(here.targets_m)
        if here.cost - there.cost <= 1e-6 * here.cost:
            return there.cost
        here = there
    return here.cost


def steps(agents: int, rounds: int) -> dict[str, float]:
    """Print CPU times of a step in units of shapely's Voronoi diagram of the same places."""
    generator = np.random.default_rng(0)
    side = 10.0 * np.ceil(np.sqrt(agents))
    ground = ConvexGround(convex_region(shapely.box(0, 0, side, side)))
    grid = np.arange(5.0, side, 10.0)
    places = np.stack(np.meshgrid(grid, grid), axis=2).reshape(-1, 2)[:agents]
    places = places + 3.0 * generator.random(places.shape)
    jobs = {
        "diagram": lambda: shapely.voronoi_polygons(shapely.multipoints(places)),
        "targets": lambda: ground.cover(places),
    }
    middle = np.full_like(places, 0.5 * side)
    found = ground.cover(places).targets_m
    plain, inert = {"speed_m_s": 3.0, "body_radius_m": 1.0}, {"acceleration_m_s2": 1.0}
    for name, aims, limits in (
        ("covering, single integrators", found, MoveLimits(**plain)),
        ("all to one place, single integrators", middle, MoveLimits(**plain)),
        ("covering, double integrators", found, MoveLimits(**plain, **inert)),
        ("all to one place, double integrators", middle, MoveLimits(**plain, **inert)),
    ):
        jobs[name] = lambda aims=aims, limits=limits: (
            plan_moves(ground, Motion.at_rest(places), aims, limits, GAIN, 10).motion
        )
    # From a crowded corner nearly all speed limits bind.
    crowd, nobody = 0.3 * places, np.zeros(agents, dtype=bool)
    fast, share = MoveLimits(speed_m_s=0.3), np.ones(agents)
    ends, none = ground.cover(crowd).targets_m, np.zeros((agents, 0, 2))
    jobs[f"spreading, cells along {AHEAD} steps"] = lambda: plan_moves(
        ground, Motion.at_rest(crowd),
        foreseen_aims(ground, crowd, ends, none, nobody, AHEAD, share, 0.3), fast, 1.0, AHEAD,
    )  # fmt: skip
    times: dict[str, float] = {}
    for name, job in jobs.items():
        begun = process_time()
        for _ in range(rounds):
            job()
        times[name] = (process_time() - begun) / rounds
        print(f"{name}: {times[name]:.3f} s of CPU, {times[name] / times['diagram']:.1f} diagrams")
    return times


def main() -> None:
    """Run one of the studies."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "study", choices=("failures", "faults", "horizons", "moving", "optima", "packing", "steps")
    )
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--agents", type=int)
    parser.add_argument("--only", choices=tuple(INERTIA), help="one setting of horizons")
    asked = parser.parse_args()
    if asked.study == "faults":
        faults(asked.first_seed, asked.runs, asked.agents or 50, 20)
    elif asked.study == "failures":
        failures(asked.first_seed, asked.runs, asked.agents or 12)
    elif asked.study == "horizons":
        horizons(asked.first_seed, asked.seeds, asked.agents or 20, 90, asked.only)
    elif asked.study == "moving":
        moving(asked.first_seed, asked.seeds, asked.agents or 12, 40)
    elif asked.study == "packing":
        packing(asked.first_seed, asked.seeds, 80)
    elif asked.study == "optima":
        optima(asked.first_seed, asked.scenes, 50)
    else:
        steps(asked.agents or 1000, 3)


if __name__ == "__main__":
    main()
