"""Networks in numbers: teams and centroidal rests, exact counts, and the cost of a step.

``python benchmarks/network_cases.py teams --cases 200`` drives random networks with an event that
stays to rest, and counts those in which exactly the agents asked for are at it and all others on
the centroids of their cells.
``python benchmarks/network_cases.py localisation --cases 100`` sends agents to an event by the
paper's law and to the ring around it, locates it from all readings along the way, and compares the
errors with the Cramer-Rao bound of the places where they measured.
``python benchmarks/network_cases.py gaps --cases 200`` compares the total distance of deferred
acceptance with the least one.
``python benchmarks/network_cases.py losses --cases 100`` compares the time until an event has its
team and the team's error of localisation, with a fifth of all messages lost, with those of the
same networks without losses, and counts the agents that respond if no message arrives at all.
``python benchmarks/network_cases.py steps --agents 1000,10000`` times a step of the laws against
shapely's Voronoi diagram of the same places, in one run.
"""

from __future__ import annotations

import argparse
import math
from time import process_time

import numpy as np
import shapely
from scipy.optimize import linear_sum_assignment

from planopt.coverage import (
    NONE,
    ConvexGround,
    ConvexRegion,
    Counting,
    Event,
    EventSensor,
    Gains,
    LawMover,
    LinkModel,
    NetworkController,
    Readings,
    Scene,
    Sensing,
    capped_demand,
    convex_region,
    coverage,
    coverage_aims,
    cramer_rao_m2,
    deferred_acceptance,
    fisher_information,
    law_moves,
    locate_event,
    measure,
    pooled,
    ring_places,
    signals,
    simulate_network,
    single_readings,
    voronoi_cells,
)

GAINS = Gains(0.5, 1.0)
SETTLED_SHARE = 0.01
"""Residual that counts as centroidal, as a share of the mean distance between agents."""


def random_region(generator: np.random.Generator) -> ConvexRegion:
    """Draw a convex polygon of about 100 m."""
    places = generator.normal(0.0, 30.0, (12, 2))
    return convex_region(shapely.MultiPoint(places).convex_hull)


def places_in(region: ConvexRegion, count: int, generator: np.random.Generator) -> np.ndarray:
    """Draw places (count, 2) uniformly."""
    low, high = region.corners_m.min(axis=0), region.corners_m.max(axis=0)
    drawn = low + (high - low) * generator.random((60 * count, 2))
    return drawn[region.excess_m(drawn) < 0.0][:count]


def team_case(seed: int) -> tuple[bool, bool]:
    """Return whether the team is exactly as large as asked for, and the rest is centroidal.

    Both are judged from the last positions alone.
    """
    generator = np.random.default_rng(seed)
    region = random_region(generator)
    count = int(generator.integers(8, 41))
    starts = places_in(region, count + 1, generator)
    demand = capped_demand(float(generator.uniform(0.1, 0.4)), 8, count // 2)
    event, settled_m = starts[-1], SETTLED_SHARE * math.sqrt(region.area_m2 / count)
    scene = Scene(
        ConvexGround(region), np.zeros(count), np.full(count, np.inf),
        (Event("event", (float(event[0]), float(event[1])), 5.0),), (demand,),
        Sensing(EventSensor(0.5, 200.0, 5.0)), None,
        "all" if seed % 2 else "coverage_only", GAINS, 1.0, Counting("leader"), None, 30, 1.0,
        1500.0, settled_m,
    )  # fmt: skip
    run = simulate_network(scene, starts[:-1], LawMover(GAINS, 1.0, 4.0), generator)
    here = run.positions_m[-1]
    # Who covers may be near to the event by chance, but not on it.
    at_event = np.linalg.norm(here - run.estimates_m[-1, 0], axis=1) <= settled_m
    generators = here if seed % 2 else here[~at_event]
    found = coverage(voronoi_cells(region, generators))
    off_m = np.linalg.norm(found.targets_m - generators, axis=1)
    off_m = off_m[~at_event] if seed % 2 else off_m
    known = np.linalg.norm(run.estimates_m[-1, 0] - event) < 1.0
    return bool(at_event.sum() == demand(count) and known), bool(off_m.max() <= 2.0 * settled_m)


def located(seed: int, agents: int, ring: bool, steps: int) -> np.ndarray:
    """Return squared errors and Cramer-Rao bounds in m^2, half-way and at the end; (2, 2).

    Agents start around the event. In each step all measure once and go on by the law, to the
    estimate or to the best ring about it.
    """
    generator = np.random.default_rng(seed)
    region = convex_region(np.array([[0, 0], [100, 0], [100, 80], [0, 80]]))
    sensor, event = EventSensor(0.5, 60.0, 3.0), np.array([50.0, 40.0])
    turn = 2.0 * np.pi * generator.random(agents)
    away = 6.0 + 9.0 * generator.random(agents)
    here = event + away[:, None] * np.stack((np.cos(turn), np.sin(turn)), axis=1)
    logs, near, rows = list[Readings](), None, list[list[float]]()
    information, responds = np.zeros((2, 2)), np.ones(agents, dtype=np.bool_)
    for step in range(1, steps + 1):
        logs.append(single_readings(here, measure(sensor, here, event, generator)))
        information += fisher_information(sensor, here, event)
        found = locate_event(sensor, pooled(logs), region, near_m=near)
        estimate = found.position_m
        near = None if step < 5 else np.vstack((estimate, found.rivals_m))
        if step in (steps // 2, steps):
            error = float(((estimate - event) ** 2).sum())
            rows.append([error, cramer_rao_m2(information)])
        aims = np.tile(estimate, (agents, 1))
        if ring:
            aims = ring_places(here, estimate, sensor.best_distance_m)
        here = law_moves(here, aims, responds, GAINS, 1.0, 2.0)
    return np.array(rows)


def localisation(first_seed: int, cases: int, steps: int) -> dict[str, list[float]]:
    """Print root mean squared errors and bounds; return the ratios, half-way and at the end."""
    ratios: dict[str, list[float]] = {}
    for agents in (3, 4, 6):
        for name, ring in (("ring", True), ("law", False)):
            each = [located(first_seed + k, agents, ring, steps) for k in range(cases)]
            errors, bounds = np.array(each).transpose(2, 0, 1)
            rms, bound = (np.sqrt(values.mean(axis=0)) for values in (errors, bounds))
            ratio = rms / bound
            # Interval by the spread of squared errors in units of their bounds.
            half = 1.96 * (errors / bounds).std(axis=0, ddof=1) / (2.0 * np.sqrt(cases)) / ratio
            print(
                f"{agents} agents, {name}: after {steps // 2} steps error {rms[0]:.4f} m, bound "
                f"{bound[0]:.4f} m; after {steps} steps error {rms[1]:.4f} m, bound "
                f"{bound[1]:.4f} m, ratio {ratio[1]:.3f} +- {half[1]:.3f}",
                flush=True,
            )
            ratios[f"{agents} {name}"] = [*ratio.tolist(), *bound.tolist()]
    return ratios


LOSSES = {
    "0 %": None,
    "20 %": LinkModel(0.0, 0.1, 100.0, -85.4),
    "all": LinkModel(-300.0, 3.0, 1.0, 300.0),
}
"""Losses of messages: a fifth at any distance up to 0.5 percentage points, and every message."""


def loss_case(seed: int, links: LinkModel | None, steps: int) -> tuple[float, float, int, int]:
    """Return the response time in s, the error in m, and how many agents respond, and unawares.

    An event appears after 10 of `steps` steps of 1 s. The response time is that until exactly the
    demanded agents respond and all of them are on their ring. The error is the root mean square of
    the last 20 steps over the estimates of the agents that respond. An agent responds unawares if
    it has never detected the event itself.
    """
    generator = np.random.default_rng(seed)
    region = random_region(generator)
    count, wanted = int(generator.integers(20, 61)), int(generator.integers(3, 8))
    starts = places_in(region, count + 1, generator)
    place, sensor = starts[-1], EventSensor(0.5, 60.0, 3.0)
    event, sensing = Event("event", (float(place[0]), float(place[1])), 10.0), Sensing(sensor)
    scene = Scene(
        ConvexGround(region), np.zeros(count), np.full(count, np.inf), (event,),
        (lambda agents: min(wanted, agents),), sensing, sensor.best_distance_m, "all", GAINS, 1.0,
        Counting(), links, 30, 1.0, float(steps), 0.1,
    )  # fmt: skip
    controller = NetworkController(scene, starts[:-1], LawMover(GAINS, 1.0, 4.0), generator)
    aware, unawares, responds = (np.zeros(count, dtype=np.bool_) for _ in range(3))
    response_s, squares_m2 = math.inf, list[float]()
    for step in range(steps):
        here = controller.motion.places_m
        signal = signals(event, sensing, here, float(step), generator)
        aware |= signal > sensing.detection_std * sensor.noise_std
        found = controller.step(here, signal[None])
        now = found.states == 0
        responds, unawares = responds | now, unawares | (now & ~aware)
        off_m = np.linalg.norm(found.targets_m - here, axis=1)[now]
        if now.sum() == wanted and off_m.max() <= 0.5:
            response_s = min(response_s, step - event.appears_s)
        if step >= steps - 20:
            errors = found.beliefs[0].places_m[now] - place
            squares_m2 += (errors**2).sum(axis=1).tolist()
    error_m = math.sqrt(float(np.mean(squares_m2))) if squares_m2 else math.inf
    return response_s, error_m, int(responds.sum()), int(unawares.sum())


def losses(first_seed: int, cases: int, steps: int = 60) -> dict[str, tuple[float, float]]:
    """Print response times and errors with losses over those without; return the ratios."""
    seeds = range(first_seed, first_seed + cases)
    # Without any message every agent locates the event by itself, so a tenth of the cases suffices.
    number = {"0 %": cases, "20 %": cases, "all": max(cases // 10, 1)}
    found = {
        name: np.array([loss_case(seed, links, steps) for seed in seeds[: number[name]]])
        for name, links in LOSSES.items()
    }
    calm, lossy = found["0 %"], found["20 %"]
    served = np.isfinite(calm[:, :2]).all(axis=1) & np.isfinite(lossy[:, :2]).all(axis=1)
    print(f"served with and without losses: {int(served.sum())} of {cases}")
    ratios: dict[str, tuple[float, float]] = {}
    for column, (name, power) in enumerate((("response time", 1), ("error", 2))):
        one, other = (each[served, column] ** power for each in (calm, lossy))
        square = float(other.mean() / one.mean())
        half = 1.96 * float((other - square * one).std()) / math.sqrt(len(one)) / float(one.mean())
        ratio = square ** (1.0 / power)
        ratios[name] = ratio, half * ratio / (power * square)
        means = [float(each.mean() ** (1.0 / power)) for each in (one, other)]
        print(
            f"{name}: {means[0]:.4g} without losses, {means[1]:.4g} with, ratio {ratio:.3f} +- "
            f"{ratios[name][1]:.3f}"
        )
    for name, each in found.items():
        respond, unaware = each[:, 2:].sum(axis=0).astype(int).tolist()
        print(f"{name} lost: {unaware} of {respond} agents respond without having sensed the event")
    return ratios


def gap_case(seed: int) -> float:
    """Return by what share three teams that deferred acceptance sends drive farther than best."""
    generator = np.random.default_rng(seed)
    region = random_region(generator)
    demands = generator.integers(1, 7, 3)
    count = int(generator.integers(demands.sum(), 41))
    places = places_in(region, count + 3, generator)
    away_m = np.linalg.norm(places[:-3, None] - places[-3:], axis=2)
    seats = away_m[:, np.repeat(np.arange(3), demands)]
    best_m = seats[linear_sum_assignment(seats)].sum()
    event_of = deferred_acceptance(away_m, demands)
    sent = np.flatnonzero(event_of != NONE)
    return away_m[sent, event_of[sent]].sum() / best_m - 1.0


def step_times(agents: int, repeats: int, seed: int) -> tuple[float, float]:
    """Return median CPU times in s of a step of the laws, and of shapely's Voronoi diagram."""
    generator = np.random.default_rng(seed)
    region = convex_region(np.array([[0, 0], [1000, 0], [1000, 1000], [0, 1000]]))
    ground, nobody = ConvexGround(region), np.zeros(agents, dtype=np.bool_)
    times_s = np.zeros((repeats, 2))
    for row in times_s:
        here = places_in(region, agents, generator)
        start = process_time()
        aims = coverage_aims(ground, here, nobody)
        law_moves(here, aims.targets_m, nobody, GAINS, 1.0, 5.0)
        middle = process_time()
        shapely.voronoi_polygons(shapely.multipoints(here), ordered=True)
        row[:] = middle - start, process_time() - middle
    law_s, shapely_s = np.median(times_s, axis=0).tolist()
    return law_s, shapely_s


def main() -> None:
    """Print one of the studies."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("study", choices=("teams", "localisation", "gaps", "losses", "steps"))
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--agents", default="1000,10000")
    asked = parser.parse_args()
    first = asked.first_seed
    if asked.study == "steps":
        for agents in map(int, asked.agents.split(",")):
            law_s, shapely_s = step_times(agents, 9, first)
            print(
                f"{agents} agents: a step of the laws {1e3 * law_s:.1f} ms CPU, shapely's Voronoi "
                f"diagram {1e3 * shapely_s:.1f} ms, ratio {law_s / shapely_s:.2f}"
            )
        return
    if asked.study == "localisation":
        localisation(first, asked.cases, 40)
        return
    if asked.study == "losses":
        losses(first, asked.cases)
        return
    if asked.study == "gaps":
        gaps = 100.0 * np.array([gap_case(first + each) for each in range(asked.cases)])
        p50, p95 = np.percentile(gaps, [50, 95])
        print(
            f"total distance above the least: median {p50:.1f} %, mean {gaps.mean():.1f} %, 95 % "
            f"of cases below {p95:.1f} %, largest {gaps.max():.1f} %; "
            f"{int((gaps < 1e-9).sum())} of {asked.cases} are best"
        )
        return
    found = np.array([team_case(seed) for seed in range(first, first + asked.cases)])
    words = ("the team is exact", "the rest is centroidal")
    for word, column in zip(words, found.T, strict=True):
        wrong = [first + int(each) for each in np.flatnonzero(~column)]
        print(
            f"{word}: {int(column.sum())} of {asked.cases}" + (f", not in {wrong}" if wrong else "")
        )


if __name__ == "__main__":
    main()
