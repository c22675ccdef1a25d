"""Pursuits in numbers: captures under a guarantee, and time to capture by horizon and evader.

``python benchmarks/pursuit_study.py captures --runs 500`` draws networks, speeds and evaders with
a below 1 and a capture radius above the floor, and counts who is not caught in time.
``python benchmarks/pursuit_study.py horizons --seeds 40`` compares planners on the library's
pursuit_fleeing with every kind of evader; ``--problem pursuit_obstacles`` among obstacles,
``--turn-rate 0.5`` for a unicycle, ``--loss 0.3`` with lost reports, ``--evaders zigzag`` for one.
``python benchmarks/pursuit_study.py teams --seeds 20`` lets 1, 2 and 3 pursuers chase one evader.
``cooperation --seeds 40`` compares 2 and 3 cooperating pursuers with `retarget`, paired by seed, in
the open or, with ``--problem pursuit_obstacles``, among obstacles; ``--evaders`` names evaders. In
the open the longest straight flight shows what is left to gain.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial

import numpy as np
from scipy.stats import t

import planopt
from planopt import compare
from planopt.problems import TaskProblem
from planopt.problems.tasks import problem_from
from planopt.pursuit import (
    Chase,
    DriveToReport,
    Evader,
    Fleeing,
    Foresighted,
    Pursuer,
    RecedingHorizon,
    Scene,
    SnapshotRecords,
    SnapshotService,
    Static,
    StraightMotion,
    Theorem,
    Wandering,
    Zigzag,
    capture_guarantees,
    contraction,
    relative_error,
    simulate_pursuit,
)

EVADERS = {
    "static": {"kind": "static"},
    "wandering": {"kind": "wandering"},
    "straight": {"kind": "wandering", "turn_std_rad": 0.0},
    "fleeing": {"kind": "fleeing"},
    "fleeing from aims": {"kind": "fleeing", "from_aims": True},
    "zigzag": {"kind": "zigzag", "period_s": 15.0},
    "foresighted": {"kind": "foresighted", "horizon": 6, "plan_step_s": 2.0},
}


def horizons(given: argparse.Namespace) -> None:
    """Print the time to capture of each planner against each kind of evader."""
    for name in given.evaders or EVADERS:
        found = compare(
            varied(given.problem, EVADERS[name], given.turn_rate, given.loss),
            (1, 5, 10),
            planners=("drive", "retarget", "receding"),
            seeds=range(given.first_seed, given.first_seed + given.seeds),
        )
        print(name)
        for row in found.rows:
            if row.metric == "capture_time_s" and row.mean is not None:
                ratio = f"{row.paired_ratio:.3f} ({row.ratio_low:.3f} to {row.ratio_high:.3f})"
                caught = f"{row.count} of {row.seeds} caught"
                print(f"  {row.planner} {row.horizon}: {row.mean:.2f} s, {ratio}, {caught}")
        sys.stdout.flush()


def varied(
    problem: str, behaviour: dict, turn_rate_rad_s: float | None = None, loss: float = 0.0
) -> TaskProblem:
    """Return a library problem with another evader, and with another pursuer or network."""
    library = planopt.load(problem)
    tables = library.tables()
    evader = {**tables["evaders"][0], "behaviour": behaviour}
    pursuer = dict(tables["pursuers"][0])
    rules = dict(tables["pursuit"])
    if turn_rate_rad_s is not None:
        pursuer["turn_rate_max_rad_s"] = turn_rate_rad_s
    if turn_rate_rad_s is not None or loss:
        # Neither a turn on the spot a stage nor lost rounds leave the guarantee that it asks for.
        rules.pop("guarantee", None)
    return problem_from(
        {
            **tables,
            "evaders": [evader],
            "pursuers": [pursuer],
            "pursuit": rules,
            "network": {**tables["network"], "loss_probability": loss},
            "report": {"figures": False},
        },
        folder=library.file.parent,
        file=None,
    )


TEAM_POLICIES = {
    "drive": DriveToReport,
    "retarget": partial(DriveToReport, retarget=True),
    "receding": partial(RecedingHorizon, horizon=10, plan_step_s=2.0, manoeuvre_s=60.0),
}
TEAM_EVADERS = {
    "wandering": Wandering(),
    "fleeing": Fleeing(),
    "zigzag": Zigzag(period_s=15.0),
    "foresighted": Foresighted(horizon=6, plan_step_s=2.0),
}


def teams(first_seed: int, seeds: int) -> None:
    """Print mean and longest time to capture of teams, and the ratio to driving in stages."""
    for count in (1, 2, 3):
        for name, behaviour in TEAM_EVADERS.items():
            scenes = [
                team(count, behaviour, seed) for seed in range(first_seed, first_seed + seeds)
            ]
            # No pursuer is sooner against an evader that runs straight away from all of them.
            straight_s = [
                min(np.linalg.norm(each - scene[1].start_m) - 15.0 for each in scene[0]) / 3.0
                for scene in scenes
            ]
            words = [f"{count} {name}: straight flight {np.mean(straight_s):.1f}"]
            drive_s = None
            for policy_name, policy in TEAM_POLICIES.items():
                lasts_s = np.array([chase_s(*scene, policy) for scene in scenes])
                drive_s = lasts_s if drive_s is None else drive_s
                share = lasts_s / drive_s
                half = 1.96 * share.std(ddof=1) / np.sqrt(seeds)
                words.append(
                    f"{policy_name} {lasts_s.mean():.1f}, worst {lasts_s.max():.1f} "
                    f"({share.mean() - half:.3f} to {share.mean() + half:.3f})"
                )
            print("; ".join(words), flush=True)


def cooperation(given: argparse.Namespace) -> None:
    """Print the ratio of cooperating pursuers' capture times to those of `retarget`, paired."""
    ground, seeds = planopt.load("pursuit_obstacles"), given.seeds
    for count in (2, 3):
        for name in given.evaders or ("fleeing", "foresighted"):
            times_s, bounds_s = [], []
            for seed in range(given.first_seed, given.first_seed + seeds):
                if given.problem == "pursuit_obstacles":
                    times_s.append(
                        [
                            among_obstacles_s(ground, count, name, seed, each)
                            for each in ("retarget", "receding")
                        ]
                    )
                else:
                    starts, evader = team(count, TEAM_EVADERS[name], seed)
                    times_s.append(
                        [
                            chase_s(starts, evader, TEAM_POLICIES[each])
                            for each in ("retarget", "receding")
                        ]
                    )
                    bounds_s.append(straight_flight_s(starts - evader.start_m))
            alone, joint = np.array(times_s).T
            words = [
                f"{count} pursuers, {name}, {seeds} seeds, largest {(joint / alone).max():.3f}"
            ]
            words += [
                f"{label} mean {each.mean():.1f} s, worst {each.max():.1f} s"
                for label, each in (("retarget", alone), ("receding", joint))
            ]
            for label, each in (("receding", joint), ("straight flight", np.array(bounds_s))):
                if len(each):
                    ratio = each / alone
                    half = t.ppf(0.975, seeds - 1) * ratio.std(ddof=1) / np.sqrt(seeds)
                    low, high = ratio.mean() + np.array([-half, half])
                    words.append(f"{label} / retarget {ratio.mean():.4f} ({low:.4f} to {high:.4f})")
            print("; ".join(words), flush=True)


def straight_flight_s(offsets_m):
    """The longest straight flight at 2 m/s from pursuers at 5 m/s that know its direction.

    No pursuers capture an evader that takes this direction earlier.
    """
    turns = np.linspace(0.0, 2.0 * np.pi, 3601)
    away = np.stack([np.cos(turns), np.sin(turns)])
    # The time s solves |2 s away - offset| = 5 s + 15.
    half = -2.0 * offsets_m @ away - 75.0
    over = (offsets_m**2).sum(axis=1) - 15.0**2
    root_s = (half + np.sqrt(half**2 + 21.0 * over[:, None])) / 21.0
    return root_s.min(axis=0).max()


def among_obstacles_s(ground, count, name, seed, policy):
    """The time to capture among the obstacles of pursuit_obstacles from random starts."""
    generator, tables = np.random.default_rng(seed), ground.tables()
    tables["evaders"][0] |= {"behaviour": EVADERS[name], "start_radius_m": 0.0}
    pursuers = [tables["pursuers"][0] | {"name": f"pursuer_{k}"} for k in range(count)]
    for each in (*pursuers, tables["evaders"][0]):
        while True:
            each["start_m"] = generator.uniform(10.0, 310.0, 2).tolist()
            if ground.arena.is_free(np.array(each["start_m"]), 1.3):
                break
    tables |= {"pursuers": pursuers, "planner": {"name": policy}}
    problem = problem_from(tables, folder=ground.file.parent, file=None)
    return planopt.simulate(problem, seed=0).value.capture_time_s


def team(count, behaviour, seed):
    """Starts of pursuers 150 to 450 m from an evader in random directions, and the evader."""
    generator = np.random.default_rng(seed)
    start = generator.uniform(-1000.0, 1000.0, 2)
    turn = generator.uniform(0.0, 2.0 * np.pi, count)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return start + generator.uniform(150.0, 450.0, (count, 1)) * ring, Evader(start, 2.0, behaviour)


def chase_s(starts, evader, policy):
    """The time to capture within 15 m, at 5 m/s against 2 m/s, on the library's motes."""
    scene = Scene(
        tuple(Pursuer(each, StraightMotion(5.0), policy) for each in starts),
        (evader,),
        SnapshotRecords(SnapshotService(8, 10.0, 0.1, 5, endless=True)),
        15.0,
        0.4,
        4000,
    )
    generator = np.random.default_rng(0)
    return simulate_pursuit(scene, generator).capture_time_s


def captures(first_seed: int, runs: int) -> None:
    """Print how many pursuits with a < 1 and a radius above the floor do not end in time."""
    late, uncaught, shares, largest = 0, 0, [], 0.0
    for seed in range(first_seed, first_seed + runs):
        generator = np.random.default_rng(seed)
        chase, service, radius_m = drawn(generator)
        promised = capture_guarantees(chase, service.bounds)[Theorem.SNAPSHOTS]
        behaviour = [
            Static(),
            Wandering(),
            Fleeing(),
            Fleeing(from_aims=True),
            Zigzag(period_s=4.0),
            Foresighted(horizon=4, plan_step_s=1.0),
        ][seed % 6]
        start = generator.uniform(-500.0, 500.0, 2)
        turn = generator.uniform(0.0, 2.0 * np.pi)
        away = generator.uniform(1.5, 8.0) * radius_m * np.array([np.cos(turn), np.sin(turn)])
        scene = Scene(
            (Pursuer(start, StraightMotion(chase.pursuer_speed_m_s), DriveToReport),),
            (Evader(start + away, chase.evader_speed_m_s, behaviour),),
            SnapshotRecords(service),
            radius_m,
            chase.stage_delay_s,
            40_000,
        )
        pursuit = simulate_pursuit(scene, generator)
        uncaught += pursuit.outcome != "captured"
        lasts_s = promised.capture_time_s(pursuit.uses[0].distance_m, radius_m)
        late += pursuit.capture_time_s > lasts_s
        shares.append(pursuit.capture_time_s / lasts_s)
        bounds = pursuit.bounds_m(0, 0)
        if len(bounds) > 1:
            largest = max(largest, float((bounds[1:] / promised.next_bound_m(bounds[:-1])).max()))
    low, middle, high = np.percentile(shares, [5, 50, 95])
    print(
        f"{runs} pursuits: {uncaught} not captured, {late} later than promised; time to capture "
        f"over its bound {middle:.2f} (5 % {low:.2f}, 95 % {high:.2f}, largest "
        f"{max(shares):.2f}); W over the bound of its stage at most {largest:.3f}"
    )


def drawn(generator: np.random.Generator) -> tuple[Chase, SnapshotService, float]:
    """Draw speeds, a network for which the snapshots' theorem holds, a radius above its floor."""
    while True:
        ratio = generator.uniform(1.3, 4.0)
        bits, divisor = int(generator.integers(2, 9)), int(generator.integers(1, 3))
        x = 10.0 ** generator.uniform(-2.0, 0.3)
        if contraction(ratio, relative_error(bits)) >= 1.0:
            continue
        service = SnapshotService(
            12, 1.0, x / (6 * (1 + divisor)), bits, rate_divisor=divisor, endless=True
        )
        floor_m = 1.0
        for _ in range(12):
            chase = Chase(1.0, ratio, 0.1 * floor_m / ratio)
            floor_m = capture_guarantees(chase, service.bounds)[Theorem.SNAPSHOTS].floor_m
            if not np.isfinite(floor_m) or floor_m > 200.0:
                break
        else:
            chase = Chase(1.0, ratio, 0.1 * floor_m / ratio)
            floor_m = capture_guarantees(chase, service.bounds)[Theorem.SNAPSHOTS].floor_m
            return chase, service, generator.uniform(1.05, 1.5) * floor_m


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("study", choices=("captures", "cooperation", "horizons", "teams"))
    parser.add_argument("--runs", type=int, default=500)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--problem", default="pursuit_fleeing")
    parser.add_argument("--turn-rate", type=float)
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--evaders", nargs="+", choices=EVADERS)
    given = parser.parse_args()
    if given.study == "captures":
        captures(given.first_seed, given.runs)
    elif given.study == "teams":
        teams(given.first_seed, given.seeds)
    elif given.study == "cooperation":
        cooperation(given)
    else:
        horizons(given)


if __name__ == "__main__":
    main()
