"""Every small falsification of how distances from what moves are judged changes a judgement."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M

APART = "planopt.planning.proof.apart"
DISCS = "planopt.world.moving_discs"
CLOSEST = "planopt.world.closest_approach"
OBSTACLE = "planopt.world.moving_obstacle"

MUTANTS = [
    (CLOSEST, "first_starts_m - second_starts_m", "first_starts_m - second_ends_m"),
    (CLOSEST, "first_ends_m - second_ends_m", "first_ends_m - second_starts_m"),
    (CLOSEST, "share = -(starts_m * along)", "share = (starts_m * along)"),
    (CLOSEST, "share, 0.0), 0.0, 1.0)", "share, 0.0), 0.0, 0.5)"),
    (CLOSEST, "share, 0.0), 0.0, 1.0)", "share, 0.0), 0.3, 1.0)"),
    (CLOSEST, "share, 0.0), 0.0, 1.0)", "share, 0.0), -9.0, 9.0)"),
    (CLOSEST, "(1.0 - share[..., None]) * along", "share[..., None] * along"),
    (CLOSEST, "starts_m + share[..., None]", "starts_m - share[..., None]"),
    (DISCS, "self.radius_m + self.least_m", "self.radius_m - self.least_m"),
    (DISCS, "path_m[:-1], path_m[1:], discs", "path_m[:-1], path_m[:-1], discs"),
    (DISCS, "discs.centres_m[:, :-1], discs.centres_m[:, 1:]\n    )\n\n\ndef ways", None),
    (APART, "- discs.radius_m", "+ discs.radius_m"),
    (APART, "- discs.radius_m", ""),
    (APART, "away - discs.least_m", "away + discs.least_m"),
    (APART, "< -CLEARANCE_TOLERANCE_M", "< 10.0 * -CLEARANCE_TOLERANCE_M"),
    (APART, "< -CLEARANCE_TOLERANCE_M", "< CLEARANCE_TOLERANCE_M"),
    (APART, ".min(axis=1)", ".max(axis=1)"),
    (APART, "step + 1", "step"),
    (APART, "np.argmin(away", "np.argmax(away"),
    (APART, "_least(away[discs.is_robot])", "_least(away[~discs.is_robot])"),
    (APART, "_least(away[~discs.is_robot])", "_least(away)"),
    (APART, "if discs.is_robot[number]", "if not discs.is_robot[number]"),
    (APART, "float(away_m.min())", "float(away_m.max())"),
    (OBSTACLE, "times_s - known[-1]", "times_s"),
    (OBSTACLE, "np.maximum(times_s - known[-1], 0.0)", "times_s - known[-1]"),
    (OBSTACLE, "0.5 * obstacle.acceleration", "obstacle.acceleration"),
    (OBSTACLE, "ahead_s**2", "ahead_s"),
    (OBSTACLE, "-2.0 * math.log", "-1.0 * math.log"),
    (OBSTACLE, "(1.0 - obstacle.probability) / 2.0", "1.0 - obstacle.probability"),
    (OBSTACLE, "now_s + step_s", "step_s"),
    (OBSTACLE, "times[1:] - now_s", "times[:-1] - now_s"),
    (OBSTACLE, "times[1:] - now_s", "times[1:]"),
    (OBSTACLE, "+ _turn_m(obstacle, times)", ""),
    (OBSTACLE, "np.full(len(obstacles), clearance_m)", "np.zeros(len(obstacles))"),
    (OBSTACLE, 'side="right") - 1', 'side="right") - 2'),
]


def source_of(module: str) -> str:
    """Its text."""
    spec = find_spec(module)
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).read_text()


def module_of(name: str, source: str, **served: object) -> ModuleType:
    """A module of that text, served by other ones."""
    module = ModuleType(f"apart_mutant_{name.rpartition('.')[2]}")
    sys.modules[module.__name__] = module
    exec(compile(source, "<mutant>", "exec"), module.__dict__)
    module.__dict__.update(served)
    return module


def judgements(changed: str = "", source: str = "") -> list[object]:
    """What is said of a few scenes by the sources, one of them changed."""
    texts = {name: source_of(name) for name in (APART, DISCS, CLOSEST, OBSTACLE)}
    if changed:
        texts[changed] = source
    closest = module_of(CLOSEST, texts[CLOSEST])
    discs = module_of(DISCS, texts[DISCS], closest_approach_m=closest.closest_approach_m)
    apart = module_of(APART, texts[APART], path_distances_m=discs.path_distances_m)
    moving = module_of(OBSTACLE, texts[OBSTACLE], MovingDiscs=discs.MovingDiscs)
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
        said.append(apart.judge_apart(found, path))
    limit = np.array([[0.0, 2.5], [1.0, 2.5], [2.0, 2.5], [3.0, 2.5]])
    line = limit - np.array([0.0, 2.5])
    for lower in (0.0, 0.5 * CLEARANCE_TOLERANCE_M, 2.0 * CLEARANCE_TOLERANCE_M):
        others = np.stack([limit - np.array([0.0, lower]), limit + 1.0 + np.arange(4.0)[:, None]])
        robots = discs.MovingDiscs(
            ("near", "far"), others, np.zeros((2, 3)), np.full(2, 2.5), np.ones(2, dtype=bool)
        )
        said.append(apart.judge_apart(robots, line))
    return [_plain(each) for each in said]


def _plain(said: object) -> object:
    """Data classes of different modules are never equal."""
    if isinstance(said, list):
        return said
    near = [
        None if value is None else round(value, 9)
        for value in (said.min_separation_m, said.min_moving_clearance_m)
    ]
    return (*near, said.reasons)


def test_sources_as_they_are():
    """Both kinds of distance, and reasons for both."""
    said = judgements()
    reasons = [reason for each in said if isinstance(each, tuple) for reason in each[2]]
    assert any("moving obstacle turning" in reason for reason in reasons)
    assert sum("robot near" in reason for reason in reasons) == 1
    assert not any("far" in reason for reason in reasons)


@pytest.mark.parametrize("number", range(len(MUTANTS)))
def test_no_mutant_survives(number):
    """It says something else, or fails."""
    module, old, new = MUTANTS[number]
    text = source_of(module)
    if new is None:
        old, new = "discs.centres_m[:, :-1], discs", "discs.centres_m[:, 1:], discs"
    assert old in text
    # The first place only: functions beside it are searches', not the verifier's.
    mutant = text.replace(old, new, 1)
    try:
        assert judgements(module, mutant) != judgements()
    except (IndexError, ValueError, TypeError):
        return
