"""Every small falsification of how distances from what moves are judged changes a judgement."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from mutants import module_of, source_of

from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.problems import DoubleIntegrator, Unicycle
from planopt.robots.dynamics import braked_motion, rolled_out
from planopt.world import PointCurve

APART = "planopt.planning.proof.motion"
WORLD = "planopt.world.motion"

TURNS = np.array([[2.5, 1.2], [2.0, -1.4], [3.0, 0.0], [1.0, 1.5]])

MUTANTS = [
    (WORLD, "first_starts_m - second_starts_m", "first_starts_m - second_ends_m"),
    (WORLD, "first_ends_m - second_ends_m", "first_ends_m - second_starts_m"),
    (WORLD, "share = -(starts_m * along)", "share = (starts_m * along)"),
    (WORLD, "share, 0.0), 0.0, 1.0)", "share, 0.0), 0.0, 0.5)"),
    (WORLD, "share, 0.0), 0.0, 1.0)", "share, 0.0), 0.3, 1.0)"),
    (WORLD, "share, 0.0), 0.0, 1.0)", "share, 0.0), -9.0, 9.0)"),
    (WORLD, "(1.0 - share[..., None]) * along", "share[..., None] * along"),
    (WORLD, "starts_m + share[..., None]", "starts_m - share[..., None]"),
    (WORLD, "self.radius_m + self.least_m", "self.radius_m - self.least_m"),
    (WORLD, "self.curves[number] if self.curves else ()", "()"),
    (WORLD, "self.curves[number] if", "self.curves[0] if"),
    (APART, "radius = discs.radius_m", "radius = 0.0 * discs.radius_m"),
    (APART, "discs.radius_m[number, :", "discs.radius_m[0, :"),
    (APART, "gaps[number] - discs.least_m", "gaps[number] + discs.least_m"),
    (APART, ">= -CLEARANCE_TOLERANCE_M", ">= 10.0 * -CLEARANCE_TOLERANCE_M"),
    (APART, ">= -CLEARANCE_TOLERANCE_M", ">= CLEARANCE_TOLERANCE_M"),
    (APART, "discs.motion(number)", "discs.motion(0)"),
    (APART, "step + 1", "step"),
    (APART, "if step < planned", "if step <= planned"),
    (APART, "if step < planned", "if step + 1 < planned"),
    (APART, "discs.counted_steps(number, motion)", "planned"),
    (WORLD, "self.steps if self.is_robot[number] else", "self.steps if True else"),
    (WORLD, "self.steps if self.is_robot[number] else", "2 if True else"),
    (WORLD, "min(motion.steps, self.steps)", "2"),
    (APART, "_least(gaps[discs.is_robot])", "_least(gaps[~discs.is_robot])"),
    (APART, "_least(gaps[~discs.is_robot])", "_least(gaps)"),
    (WORLD, "unknown = first.within_m + second.within_m", "unknown = first.within_m"),
    (WORLD, "unknown = first.within_m + second.within_m", "unknown = second.within_m"),
    (WORLD, "first.curving_m + second.curving_m", "first.curving_m"),
    (WORLD, "first.curving_m + second.curving_m", "second.curving_m"),
    (WORLD, "np.union1d(first.breaks, second.breaks)", "first.breaks"),
    (WORLD, "np.union1d(first.breaks, second.breaks)", "second.breaks"),
    (WORLD, "first.at(begin), first.at(end)", "first.at(begin), first.at(begin)"),
    (WORLD, "second.at(begin), second.at(end)", "second.at(end), second.at(begin)"),
    (WORLD, "(end - begin) ** 2 / 8.0", "(end - begin) ** 2 / 80.0"),
    (WORLD, "chord + off).min()", "chord - off).min()"),
    (WORLD, "lower = chord - off", "lower = chord + off"),
    (WORLD, "close = max(CLOSE_M", "close = max(1e4 * CLOSE_M"),
    (WORLD, "[middle, end]", "[middle, middle]"),
    (WORLD, "settled - unknown", "settled + unknown"),
    (WORLD, "settled - unknown", "settled"),
    (WORLD, "b[:-1], b[1:]", "b[1:], b[:-1]"),
    (
        WORLD,
        "gaps = chord_distances_m(one, other) - taken_m",
        "gaps = chord_distances_m(one, other)",
    ),
    (WORLD, "float(gaps.min())", "float(gaps.max())"),
    (WORLD, "int(gaps.argmin())", "int(gaps.argmax())"),
    (
        WORLD,
        "and not other.curves:\n        return float",
        "or not other.curves:\n        return float",
    ),
    (WORLD, "gaps - one.bulges_m - other.bulges_m", "gaps + one.bulges_m + other.bulges_m"),
    (WORLD, "gaps - one.bulges_m - other.bulges_m", "gaps - other.bulges_m"),
    (WORLD, "if lower[k] >= best", "if lower[k] < best"),
    (WORLD, "best + taken) -", "best) -"),
    (WORLD, "- taken\n", "\n"),
    (WORLD, "if gap < best:", "if gap > best:"),
    (WORLD, "if step >= self.steps", "if step > self.steps"),
    (WORLD, "self.places_m[-1:].repeat(2", "self.places_m[:1].repeat(2"),
    (WORLD, "np.minimum(np.arange(steps + 1), self.steps)", "np.zeros(steps + 1, dtype=int)"),
    (WORLD, "float(np.linalg.norm(off, axis=1).max())", "0.0"),
    (WORLD, "curve.curving_m * float(np.diff(curve.breaks).max()) ** 2 / 8.0", "0.0"),
    (APART, "if discs.is_robot[number]", "if not discs.is_robot[number]"),
    (APART, "float(away_m.min())", "float(away_m.max())"),
    (WORLD, "times_s - known[-1]", "times_s"),
    (WORLD, "np.maximum(times_s - known[-1], 0.0)", "times_s - known[-1]"),
    (WORLD, "0.5 * obstacle.acceleration", "obstacle.acceleration"),
    (WORLD, "ahead_s**2", "ahead_s"),
    (WORLD, "-2.0 * math.log", "-1.0 * math.log"),
    (WORLD, "(1.0 - obstacle.probability) / 2.0", "1.0 - obstacle.probability"),
    (WORLD, "now_s + step_s", "step_s"),
    (WORLD, "times[1:] - now_s", "times[:-1] - now_s"),
    (WORLD, "times[1:] - now_s", "times[1:]"),
    (WORLD, "+ _turn_m(obstacle, times)", ""),
    (WORLD, "np.full(len(obstacles), clearance_m)", "np.zeros(len(obstacles))"),
    (WORLD, 'side="right") - 1', 'side="right") - 2'),
]


def judgements(changed: str = "", source: str = "") -> list[object]:
    """What is said of a few scenes by the sources, one of them changed."""
    texts = {APART: source_of(APART), WORLD: source_of(WORLD)}
    if changed:
        texts[changed] = source
    moving = module_of(WORLD, texts[WORLD])
    apart = module_of(APART, texts[APART], least_gap=moving.least_gap)
    one = moving.MovingObstacle
    carts = (
        one("straight", 1.0, (0.0,), ((6.0, -3.0),), (-1.0, 1.5)),
        one("turning", 0.5, (1.0, 2.6, 4.0), ((9.0, 2.0), (4.0, 1.0), (4.0, 9.0))),
        one("unsure", 0.5, (0.0,), ((4.0, 6.0),), (0.0, -0.5), 0.1, 0.2, 0.9),
        one("later", 0.5, (2.0,), ((5.0, -8.0),), (0.0, 1.0)),
        one("leaving", 0.5, (1.5, 2.5), ((8.0, -8.0), (5.0, -2.0)), (-1.0, 3.0)),
    )
    path = np.array([[0.0, 0.0], [1.5, 0.5], [3.5, 0.0], [5.0, 1.0]])
    said: list[object] = []
    for now in (0.0, 1.0):
        found = moving.predicted_discs(carts, now, 1.0, 3, 0.5)
        said.append(np.round(found.apart_m, 9).tolist())
        said.append(apart.verify_apart(found, moving.TimedMotion(path)))
    limit = np.array([[0.0, 2.5], [1.0, 2.5], [2.0, 2.5], [3.0, 2.5]])
    line = limit - np.array([0.0, 2.5])
    for lower in (0.0, 0.5 * CLEARANCE_TOLERANCE_M, 2.0 * CLEARANCE_TOLERANCE_M):
        others = np.stack([limit - np.array([0.0, lower]), limit + 1.0 + np.arange(4.0)[:, None]])
        robots = moving.MovingDiscs(
            ("near", "far"), others, np.zeros((2, 3)), np.full(2, 2.5), np.ones(2, dtype=bool)
        )
        said.append(apart.verify_apart(robots, moving.TimedMotion(line)))
    said += [
        apart.verify_apart(others, own, planned)
        for others, own, planned in driven(moving.TimedMotion, moving.MovingDiscs)
    ]
    return [_plain(each) for each in said]


def driven(motion: type, moving: type) -> Iterator[tuple[Any, Any, int]]:
    """Robots on curves beside others on curves, some of them only near while they stop."""
    heavy = DoubleIntegrator(3.0, 1.0)
    coasting = rolled_out(heavy, np.array([0.0, 0.0, 2.0, 0.5]), np.zeros((2, 2)), 1.0)
    turning = rolled_out(heavy, np.array([4.0, 5.0, 0.0, -2.0]), np.array([[0.6, 0.7]] * 4), 1.0)
    wheels = rolled_out(Unicycle(3.0, 1.5), np.array([-1.0, 4.0, -0.6]), TURNS, 1.0)
    loose = tuple(
        PointCurve(np.array([[k, -3.0], [k + 0.2, -2.6], [k + 1.0, -3.0]]), 0.1) for k in range(4)
    )
    loosely = motion(np.array([[float(k), -3.0] for k in range(5)]), loose)
    motions = [braked_motion(one.positions_m, one, 1.0) for one in (coasting, turning, wheels)]
    own = [motion(each.places_m, each.curves) for each in motions] + [loosely]
    place = np.array([[9.0, 3.0], [8.5, 2.5], [8.0, 2.0], [6.0, 1.5]])
    own.append(motion(place))
    for number, one in enumerate(own):
        others = [each.lasting(5) for other, each in enumerate(own) if other != number]
        for kind in (True, False):
            yield (
                moving(
                    tuple("abcd"),
                    np.array([each.places_m for each in others]),
                    np.tile([[0.0], [0.3], [0.1], [0.2]], (1, 5)) + 0.01 * np.arange(5),
                    np.full(4, 1.3),
                    np.array([kind, kind, True, kind]),
                    tuple(each.curves for each in others),
                ),
                one,
                2,
            )
    # The nearest step by its chord is not the nearest one: one bulges, the other does not.
    along = np.array([[0.0, 0.0], [4.0, 0.0], [8.0, 0.0]])
    straight = PointCurve(along[:2], 0.0)
    for swing, size in ((-2.6, 0.0), (0.4, 0.0), (-0.7, 0.8)):
        bump = PointCurve(np.array([[4.0, 3.0], [6.0, 3.0 + swing], [8.0, 3.0]]), 0.0)
        even = PointCurve(np.array([[0.0, 2.5], [4.0, 3.0]]), 0.0)
        other = motion(np.array([[0.0, 2.5], [4.0, 3.0], [8.0, 3.0]]), (even, bump))
        beside = moving(
            ("bumping",),
            other.places_m[None],
            np.array([[0.0, size]]),
            np.array([1.0]),
            np.array([False]),
            (other.curves,),
        )
        waved = motion(along, (straight, PointCurve(along[1:], 0.0)))
        yield beside, waved, 2
        yield beside, motion(along), 2
    late = np.array([[8.0, 9.0], [8.0, 8.0], [8.0, 7.0], [9.0, 3.0], [7.0, 1.0]])
    coming = moving(("coming",), late[None], np.zeros((1, 4)), np.array([3.0]), np.array([True]))
    yield coming, waved, 2
    still = motion(np.zeros((3, 2)), (PointCurve(np.zeros((3, 2)), 0.0),) * 2)
    for away in (2.5, 2.5 - 0.5 * CLEARANCE_TOLERANCE_M, 2.5 - 2.0 * CLEARANCE_TOLERANCE_M):
        beside = moving(
            ("near",),
            np.array([[[0.0, away]] * 3]),
            np.zeros((1, 2)),
            np.array([2.5]),
            np.array([True]),
        )
        yield beside, still, 2


def _plain(said: object) -> object:
    """Data classes of different modules are never equal."""
    if isinstance(said, list):
        return said
    near = [
        None if value is None else round(value, 9)
        for value in (said.min_separation_m, said.min_moving_clearance_m)
    ]
    return (*near, said.reasons)


TRUE = judgements()


def test_sources_as_they_are():
    """Both kinds of distance, and reasons for both."""
    reasons = [reason for each in TRUE if isinstance(each, tuple) for reason in each[2]]
    assert any("moving obstacle turning" in reason for reason in reasons)
    assert sum("robot near" in reason for reason in reasons) == 2
    assert not any("far" in reason for reason in reasons)


@pytest.mark.parametrize("number", range(len(MUTANTS)))
def test_no_mutant_survives(number):
    module, old, new = MUTANTS[number]
    text = source_of(module)
    assert old in text
    # The first place only: functions beside it are searches', not the verifier's.
    mutant = text.replace(old, new, 1)
    try:
        assert judgements(module, mutant) != TRUE
    except (IndexError, ValueError, TypeError):
        return
