"""Worst evaders against the guarantee of snapshots, by simulation in continuous time.

``python benchmarks/pursuit_adversary.py --cases 12`` draws chases, sets the capture radius to
``--share`` times the floor (or the record rate to that multiple of its least value, ``--rate``),
and lets an evader that knows everything optimise its start, the phase of the rounds, and its
headings: by the cross-entropy method, then by random changes of a few headings. It shares no code
with planopt's simulation: pursuers drive without time steps, and captures are roots of quadratics.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass

import numpy as np

from planopt.pursuit import Chase, SnapshotService, Theorem, capture_guarantees

FINER = 4
"""Headings last a round of one of this many levels below that of the first record."""

MAX_LEGS = 100
"""Largest number of headings; they repeat after that."""


@dataclass(frozen=True)
class Rounds:
    """Rounds of snapshots on an endless grid of unit cells."""

    levels: int
    round_s: float  # Of level 0, from sample to delivery; periods are rounds times `divisor`
    divisor: int
    bits: int

    def sampled_s(self, time_s, level):
        """The sample time of the last round of a level that ended."""
        lasts_s = self.round_s * 2**level
        return math.floor((time_s - lasts_s) / lasts_s / self.divisor + 1e-9) * (
            lasts_s * self.divisor
        )

    def next_end_s(self, time_s):
        """The time at which the next round of any level ends."""
        lasts_s = [self.round_s * 2**level for level in range(self.levels + 1)]
        return min(
            (math.floor((time_s - each) / each / self.divisor + 1e-9) + 1) * each * self.divisor
            + each
            for each in lasts_s
        )

    def record(self, time_s, x, y, at):
        """Level, sample time, reported place and error of the finest record; None if none."""
        column, row = math.floor(x), math.floor(y)
        for level in range(self.levels + 1):
            sampled_s = self.sampled_s(time_s, level)
            there = [math.floor(each) for each in at(sampled_s)]
            away = (column >> level) - (there[0] >> level), (row >> level) - (there[1] >> level)
            if max(abs(away[0]), abs(away[1])) <= 1:
                fine = max(0, level - self.bits)
                side = 2**fine
                place = [((each >> fine) + 0.5) * side for each in there]
                return level, sampled_s, *place, side * math.sqrt(0.5)
        return None


@dataclass(frozen=True)
class Chased:
    """Course of a pursuit: time to capture, and the bound W at each record."""

    capture_s: float
    bounds_m: list[float]


def chased(rounds, alpha, radius, start, level, first_m, headings, leg_s, most_s):
    """The pursuit of an evader of speed 1 from its first record on; None if another level shows it.

    `start` has the phase of the rounds, the pursuer's place in its cell and the evader's bearing.
    Headings are relative to the direction away from the pursuer's aim.
    """
    begin_s = (start[0] % 1.0) * rounds.round_s * rounds.divisor * 2**rounds.levels
    side = 2.0 ** (level + 3)
    x, y = (start[1] % 1.0) * side, (start[2] % 1.0) * side
    now_s = rounds.sampled_s(begin_s, level)
    times = [now_s]
    xs, ys = [x + first_m * math.cos(start[3])], [y + first_m * math.sin(start[3])]

    def at(time_s):
        last = len(times) - 1
        while last > 0 and times[last - 1] > time_s:
            last -= 1
        if last == 0 or time_s >= times[last]:
            return xs[last], ys[last]
        share = (time_s - times[last - 1]) / (times[last] - times[last - 1])
        return (
            xs[last - 1] + share * (xs[last] - xs[last - 1]),
            ys[last - 1] + share * (ys[last] - ys[last - 1]),
        )

    aim = held = None
    drives, arrive_s, leg_ends_s, leg = False, begin_s, now_s, 0
    bounds = []
    ex = ey = 0.0
    while now_s - begin_s < most_s:
        if now_s >= leg_ends_s - 1e-12:
            feared = aim or (x, y)
            turn = math.atan2(ys[-1] - feared[1], xs[-1] - feared[0])
            turn += headings[leg % len(headings)]
            ex, ey, leg, leg_ends_s = math.cos(turn), math.sin(turn), leg + 1, now_s + leg_s
        lasts_s = min(leg_ends_s, arrive_s) - now_s
        px = py = 0.0
        if drives:
            away = math.hypot(aim[0] - x, aim[1] - y)
            if away > 1e-12:
                px, py = alpha * (aim[0] - x) / away, alpha * (aim[1] - y) / away
        if now_s >= begin_s - 1e-12:
            rx, ry, mx, my = xs[-1] - x, ys[-1] - y, ex - px, ey - py
            over, half = rx * rx + ry * ry - radius * radius, rx * mx + ry * my
            if over <= 0.0:
                return Chased(now_s - begin_s, bounds)
            square = mx * mx + my * my
            inside = half * half - square * over
            if square > 0.0 and inside >= 0.0:
                soonest_s = (-half - math.sqrt(inside)) / square
                if 0.0 <= soonest_s <= lasts_s:
                    return Chased(now_s + soonest_s - begin_s, bounds)
        x, y, now_s = x + px * lasts_s, y + py * lasts_s, now_s + lasts_s
        times.append(now_s)
        xs.append(xs[-1] + ex * lasts_s)
        ys.append(ys[-1] + ey * lasts_s)
        if now_s < arrive_s - 1e-12:
            continue
        if drives:
            x, y = aim
        found = rounds.record(now_s, x, y, at)
        if held is None and (found is None or found[0] != level):
            return None
        drives = False
        if found is not None:
            newer = held is None or found[1] > held[0] + 1e-9
            if newer or (abs(found[1] - held[0]) <= 1e-9 and found[4] < held[1] - 1e-9):
                held, aim, drives = (found[1], found[4]), (found[2], found[3]), True
                there = at(found[1])
                bounds.append(math.hypot(there[0] - x, there[1] - y) + now_s - found[1])
        arrive_s = now_s + math.hypot(aim[0] - x, aim[1] - y) / alpha
        if not drives or arrive_s < now_s + 1e-12:
            drives, arrive_s = False, rounds.next_end_s(now_s)
    return Chased(most_s, bounds)


def worst(rounds, alpha, radius, first_m, most_s, seed, *, population=100, generations=25, tries=0):
    """The longest pursuit that an optimised evader reaches, and every pursuit's W on request."""
    generator = np.random.default_rng(seed)
    lag = 2.0 * rounds.round_s * rounds.divisor
    top = max([0] + [j for j in range(1, rounds.levels) if 2 ** (j - 1) * (1.0 - lag) <= first_m])
    best = Chased(0.0, [])
    for level in range(max(0, top - 1), top + 1):
        for finer in range(max(0, level - FINER), max(1, level)):
            leg_s = rounds.round_s * 2**finer
            legs = min(MAX_LEGS, max(4, math.ceil(most_s / leg_s)))

            def run(numbers, level=level, leg_s=leg_s):
                found = chased(
                    rounds,
                    alpha,
                    radius,
                    numbers[:4].tolist(),
                    level,
                    first_m,
                    numbers[4:].tolist(),
                    leg_s,
                    most_s,
                )
                return found or Chased(-1.0, [])

            mean = np.zeros(4 + legs)
            spread = np.append([1.0, 1.0, 1.0, 2.0], np.ones(legs))
            elite = None
            for _ in range(generations):
                drawn = mean + spread * generator.standard_normal((population, 4 + legs))
                if elite is None:
                    drawn[:, :3] = generator.uniform(size=(population, 3))
                    drawn[:, 3] = generator.uniform(0.0, 2.0 * np.pi, population)
                    drawn[: population // 3, 4:] = 0.0
                    # At the edge of its cell the pursuer misses an evader straight ahead longest.
                    edge = slice(population // 6)
                    off = 10.0 ** generator.uniform(-6.0, 0.0, (population // 6, 2))
                    drawn[edge, 1], drawn[edge, 3] = (1.0 - off[:, 0]) / 16.0, off[:, 1]
                else:
                    drawn[:3] = elite[:3]
                lasts_s = np.array([run(each).capture_s for each in drawn])
                elite = drawn[np.argsort(-lasts_s)[: max(4, population // 8)]]
                mean, spread = elite.mean(axis=0), 0.9 * elite.std(axis=0) + 1e-3
            numbers = elite[0]
            found = run(numbers)
            for _ in range(tries):
                changed = numbers.copy()
                index = generator.integers(0, len(numbers), generator.integers(1, 4))
                size = 10.0 ** generator.uniform(-2.5, 0.3)
                changed[index] += size * generator.standard_normal(len(index))
                other = run(changed)
                if other.capture_s >= found.capture_s:
                    numbers, found = changed, other
            if found.capture_s > best.capture_s:
                best = found
    return best


def guarantee_of(alpha, bits, round_s, divisor=1):
    """The guarantee of snapshots for unit cells and an evader of speed 1, without time steps."""
    service = SnapshotService(11, 1.0, round_s / 3.0, bits, rate_divisor=divisor, endless=True)
    return capture_guarantees(Chase(1.0, alpha), service.bounds)[Theorem.SNAPSHOTS]


def least_rate_s(alpha, bits, radius):
    """The longest level-0 round for which capture within a radius is guaranteed."""
    low, high = 0.0, 1.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        holds = guarantee_of(alpha, bits, middle).captures(radius).holds
        low, high = (middle, high) if holds else (low, middle)
    return low


def main() -> None:
    """Print the guaranteed time of every case over the longest that was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=12)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--share", type=float, default=2.0, help="radius over the floor, or rate")
    parser.add_argument("--rate", action="store_true", help="vary the record rate, not the radius")
    parser.add_argument("--tries", type=int, default=1500)
    given = parser.parse_args()
    ratios = []
    for seed in range(given.first_seed, given.first_seed + given.cases):
        generator = np.random.default_rng(seed)
        alpha, bits = generator.uniform(1.5, 4.0), int(generator.integers(4, 8))
        if given.rate:
            radius = generator.uniform(3.0, 10.0)
            round_s = least_rate_s(alpha, bits, radius) / given.share
            guarantee = guarantee_of(alpha, bits, round_s)
        else:
            while True:
                round_s = 0.5 * generator.uniform(0.1, 0.7)
                guarantee = guarantee_of(alpha, bits, round_s)
                if guarantee.holds:
                    break
            radius = given.share * guarantee.floor_m
        first_m = radius * generator.uniform(4.0, 12.0)
        if not guarantee.captures(radius).holds:
            continue
        limit_s = guarantee.capture_time_s(first_m, radius)
        begun_s = time.process_time()
        found = worst(
            Rounds(11, round_s, 1, bits),
            alpha,
            radius,
            first_m,
            1.05 * limit_s,
            seed,
            tries=given.tries,
        )
        assert found.capture_s <= limit_s
        ratios.append(limit_s / found.capture_s)
        print(
            f"seed {seed}: alpha {alpha:.2f}, c {bits}, y {2 * round_s:.3f}, radius {radius:.2f}, "
            f"first {first_m:.1f}: guaranteed {limit_s:.1f}, found {found.capture_s:.1f}, ratio "
            f"{ratios[-1]:.3f} ({time.process_time() - begun_s:.0f} s)",
            flush=True,
        )
    print(f"{len(ratios)} cases: ratio {np.mean(ratios):.3f} on average, {max(ratios):.3f} at most")


if __name__ == "__main__":
    main()
