"""Random problems over all tasks, by seed: what a closed loop has to come through unharmed.

One to three robots among 0 to 40 obstacles of all shapes (thin, not convex, with courtyards,
across the border, overlapping), a channel between weak and Munich-like, thresholds from always met
to never, few measurements or many, every planner, horizons 1 to 20. From the seed `WIDE_FROM` on
also rules of connectivity, dynamics, what moves and distances between robots.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import shapely
from closed_loop_wide import with_more

from planopt import InputError, Problem
from planopt.problems.problem import problem_from_tables

Tables = dict[str, Any]
Ring = list[list[float]]

TASKS = ("reach", "reach", "track", "learn", "map")
"""As often as each stands here; `reach` has two costs to go."""
CRITERIA = ("T", "D", "A", "V")
FORMS = ("information", "average", "path", "two_layer")
FITS = ("reml", "reml", "reml", "convex", "nls", "capped", "lemma1")
MUNICH_LIKE = {"shadow_std_db": 9.0, "decorrelation_m": 70.0, "multipath_std_db": 4.0}
OBSTACLES = (0, 1, 3, 6, 12, 25, 40)
THRESHOLD_SHARES = (0.01, 0.1, 0.3, 0.5, 0.7, 1.0, 1.0, 2.0, 2.0, 5.0, 5.0)
"""The threshold is the path loss at so much of the workspace's diagonal."""
MAX_STEPS = 12
"""Of a closed loop, so that many scenes are seen."""
WIDE_FROM = 100_000
"""Seeds from here on have what :mod:`closed_loop_wide` draws."""
WIDE_DRAWS = 20
"""Draws of it before a scene is given up: a disc where a robot starts, say, does not fit."""
PLACE_DRAWS = 400
"""Places drawn for a robot before the scene is given up."""


def random_problem(seed: int, max_steps: int = MAX_STEPS) -> Problem:
    """The problem of a seed; scenes whose obstacles leave a robot no place are drawn again."""
    generator = np.random.default_rng(seed)
    while True:
        tables = _tables(generator, f"scene_{seed}")
        if tables is None:
            continue
        tables["planner"]["max_steps"] = max_steps
        try:
            problem = problem_from_tables(tables, folder=Path(), file=None)
            if seed < WIDE_FROM:
                return problem
            wide = _wide_problem(tables, np.random.default_rng([seed, 1]))
            if wide is not None:
                return wide
        except InputError as error:
            # A footprint may cross itself; anything else would be a fault of the generator.
            if error.key is None or not error.key.startswith("world.obstacles"):
                raise


def _wide_problem(tables: Tables, generator: np.random.Generator) -> Problem | None:
    """The first draw of more that fits; None where none does."""
    for _ in range(WIDE_DRAWS):
        try:
            return problem_from_tables(with_more(tables, generator), folder=Path(), file=None)
        except InputError:
            continue
    return None


def _tables(generator: np.random.Generator, name: str) -> Tables | None:
    """The tables of one problem; None where a robot finds no place."""
    task = str(generator.choice(TASKS))
    width, height = generator.uniform(20.0, 120.0, 2)
    low = generator.choice([0.0, -50.0, 1000.0], 2)
    bounds = [*low.tolist(), float(low[0] + width), float(low[1] + height)]
    step_s = float(generator.choice([0.2, 1.0, 3.0]))
    step_m = max(width, height) / generator.uniform(10.0, 60.0)
    clearance = float(generator.choice([0.0, 0.1, 0.5, 1.5]))
    obstacles = [
        _obstacle(generator, np.asarray(bounds)) for _ in range(generator.choice(OBSTACLES))
    ]
    robots = _robots(generator, task, bounds, obstacles, clearance, step_m / step_s)
    if robots is None:
        return None
    truth = _truth(generator, max(width, height))
    station = _station(generator, np.asarray(bounds), truth)
    tables: Tables = {
        "problem": {"schema": 1, "name": name, "task": task},
        "world": {"bounds_m": bounds, "obstacles": obstacles},
        "channel": {
            "truth": truth,
            "measurements": {
                "count": int(generator.choice([3, 12, 40, 100, 250])),
                "spacing_m": float(step_m * generator.choice([0.0, 0.3, 1.0, 2.0])),
            },
            "fit": {"method": str(generator.choice(FITS))},
        },
        "robots": robots,
        "stations": [station],
        "constraints": {"clearance_m": clearance, "p_min": _p_min(generator, task)},
        "planner": {
            "name": _planner(generator, task),
            "step_s": step_s,
            "horizon": int(generator.choice([1, 2, 3, 5, 8, 10, 15, 20])),
            "neighbours": int(generator.choice([4, 16, 48])),
        },
    }
    if task == "reach":
        tables["constraints"]["goal_radius_m"] = float(step_m * generator.choice([0.1, 0.5, 2.0]))
        tables["objective"] = {
            "cost_to_go": str(generator.choice(["geodesic", "connected"])),
            "effort_weight_s2_m2": float(generator.choice([0.0, 0.1, 1.0])),
        }
        return tables
    tables["objective"] = {"terms": _terms(generator, task)}
    if any(term["kind"] == "tracking" for term in tables["objective"]["terms"]):
        tables["targets"] = [_target(generator, np.asarray(bounds), step_m / step_s)]
    return tables


def _p_min(generator: np.random.Generator, task: str) -> float:
    """Least probability of connection: none in three of ten, but for `reach`."""
    if task != "reach" and generator.uniform() < 0.3:
        return 0.0
    return float(generator.choice([0.05, 0.5, 0.8, 0.9, 0.99]))


def _planner(generator: np.random.Generator, task: str) -> str:
    if generator.uniform() < 0.75:
        return "auto"
    others = ["lattice"] if task == "reach" else ["lattice", "one_step", "random", "lawnmower"]
    return str(generator.choice(others))


def _truth(generator: np.random.Generator, side_m: float) -> Tables:
    """A model truth, Munich-like in a quarter of the scenes."""
    law = {
        "shadow_std_db": float(generator.choice([0.0, 2.0, 4.0, 8.0])),
        "decorrelation_m": float(generator.choice([2.0, 5.0, 20.0])),
        "multipath_std_db": float(generator.choice([0.5, 1.5, 4.0])),
    }
    if generator.uniform() < 0.25:
        law = dict(MUNICH_LIKE)
    truth: Tables = {
        "kind": "model",
        "k_pl_db": float(generator.uniform(-50.0, 0.0)),
        "n_pl": float(generator.uniform(1.5, 4.5)),
        "cell_m": side_m / 100.0,
        **law,
    }
    if generator.uniform() < 0.25:
        del truth["multipath_std_db"]
        truth["multipath"] = [
            {"kind": "rician", "k": 5.0},
            {"kind": "nakagami", "m": 1.5},
            {"kind": "rayleigh"},
        ][generator.integers(3)]
    return truth


def _station(generator: np.random.Generator, bounds: np.ndarray, truth: Tables) -> Tables:
    """Inside or beside the workspace; its threshold is met everywhere, in parts, or nowhere."""
    low, size = bounds[:2], bounds[2:] - bounds[:2]
    place = low + size * generator.uniform(-0.2, 1.2, 2)
    share = float(generator.choice(THRESHOLD_SHARES))
    away = share * float(np.hypot(*size))
    power = truth["k_pl_db"] - 10.0 * truth["n_pl"] * np.log10(max(away, 1.0))
    # A receiver's floor somewhat below the threshold censors what is weaker.
    if generator.uniform() < 0.2:
        truth["floor_db"] = float(power - generator.uniform(1.0, 15.0))
    return {
        "position_m": place.tolist(),
        "height_m": float(generator.choice([0.0, 2.0, 20.0])),
        "transmit_power_dbm": 10.0,
        "threshold_dbm": float(power + 10.0),
    }


def _terms(generator: np.random.Generator, task: str) -> list[Tables]:
    """The task's term; in four of ten scenes others with it."""
    first = {"track": _tracking, "learn": _learning, "map": _mapping}[task](generator)
    terms = [first]
    if generator.uniform() < 0.4:
        others = [term(generator) for term in (_tracking, _learning, _mapping)]
        energy = {
            "kind": "motion_energy",
            "weight": float(10.0 ** generator.uniform(-4.0, 0.0)),
            "per_metre_j_m": 7.4,
            "power_w": 0.3,
        }
        drawn = generator.permutation(4)[: generator.integers(1, 3)]
        terms += [[*others, energy][index] for index in drawn]
    steering = [at for at, term in enumerate(terms) if term.get("form") == "two_layer"]
    return [term for at, term in enumerate(terms) if at not in steering[1:]]


def _weight(generator: np.random.Generator) -> float:
    return float(generator.choice([0.0, 0.01, 1.0, 1.0, 100.0]))


def _tracking(generator: np.random.Generator) -> Tables:
    return {
        "kind": "tracking",
        "weight": _weight(generator),
        "noise_curvature": 0.008,
        "noise_floor_m2": float(generator.choice([0.001, 0.08, 10.0])),
        "sweet_spot_m": float(generator.choice([0.0, 1.0, 10.0])),
    }


def _learning(generator: np.random.Generator) -> Tables:
    return {
        "kind": "path_loss_learning",
        "weight": _weight(generator),
        "criterion": str(generator.choice(CRITERIA)),
    }


def _mapping(generator: np.random.Generator) -> Tables:
    table = {"kind": "mapping", "weight": _weight(generator), "form": str(generator.choice(FORMS))}
    own = {
        "variance_threshold_db2": float(generator.choice([0.0, 5.0, 50.0])),
        "closeness_per_m": float(generator.choice([0.0, 0.1])),
    }
    return table | own if table["form"] in ("path", "two_layer") else table


def _target(generator: np.random.Generator, bounds: np.ndarray, speed_m_s: float) -> Tables:
    """A target in or near the workspace, standing or as fast as a robot or faster."""
    low, size = bounds[:2], bounds[2:] - bounds[:2]
    return {
        "start_m": (low + size * generator.uniform(-0.1, 1.1, 2)).tolist(),
        "velocity_m_s": (
            speed_m_s * generator.choice([0.0, 0.5, 2.0]) * generator.uniform(-1.0, 1.0, 2)
        ).tolist(),
        "acceleration_std_m_s2": float(generator.choice([0.0, 0.03, 1.0])),
        "position_std_m": float(generator.choice([0.1, 1.0, 10.0])),
    }


def _robots(
    generator: np.random.Generator,
    task: str,
    bounds: list[float],
    obstacles: list[Tables],
    clearance: float,
    speed_m_s: float,
) -> list[Tables] | None:
    """One robot with a goal, or one to three; all at free places, if there are some."""
    polygons = [shapely.Polygon(table["polygon"], table.get("holes")) for table in obstacles]
    if not all(polygon.is_valid for polygon in polygons):
        return None
    taken = shapely.union_all(polygons)
    count = 1 if task == "reach" else int(generator.integers(1, 4))
    robots: list[Tables] = []
    for number in range(count):
        places: list[list[float]] = []
        for _ in range(PLACE_DRAWS):
            place = generator.uniform(bounds[:2], bounds[2:])
            if shapely.Point(place).distance(taken) > clearance + 1e-3 or not obstacles:
                places.append(place.tolist())
            if len(places) == 2:
                break
        if len(places) < 2:
            return None
        robot: Tables = {"name": f"robot_{number}", "start_m": places[0]}
        if task == "reach":
            robot["goal_m"] = places[1]
        robots.append({**robot, "speed_max_m_s": speed_m_s * float(generator.uniform(0.5, 1.0))})
    return robots


def _obstacle(generator: np.random.Generator, bounds: np.ndarray) -> Tables:
    """One obstacle of a random shape, size, place and heading; it may reach over the border."""
    size = bounds[2:] - bounds[:2]
    centre = bounds[:2] + size * generator.uniform(0.0, 1.0, 2)
    radius = float(size.min() * generator.uniform(0.01, 0.12))
    shape = str(generator.choice(["convex", "thin", "cup", "ring", "star", "border"]))
    rings = _shape(generator, shape, radius)
    angle = generator.choice([0.0, generator.uniform(0.0, 2.0 * np.pi)])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if shape == "border":
        centre[generator.integers(2)] = bounds[generator.choice([0, 1])]
    outer, *holes = [(centre + np.asarray(ring) @ turn.T).tolist() for ring in rings]
    return {"polygon": outer, "holes": holes} if holes else {"polygon": outer}


def _shape(generator: np.random.Generator, shape: str, radius: float) -> list[Ring]:
    """The rings of a shape about the origin, the outer one first."""
    r, t = radius, 0.25 * radius
    if shape == "convex":
        corners = int(generator.integers(3, 9))
        angle = np.sort(generator.uniform(0.0, 2.0 * np.pi, corners))
        return [(r * np.column_stack([np.cos(angle), np.sin(angle)])).tolist()]
    if shape == "star":
        corners = 2 * int(generator.integers(3, 8))
        angle = 2.0 * np.pi * np.arange(corners) / corners
        away = np.where(np.arange(corners) % 2, r, r * generator.uniform(0.2, 0.9, corners))
        return [(away[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])).tolist()]
    if shape == "thin":
        half, length = 10.0 ** generator.uniform(-3.0, -0.5), 3.0 * r
        return [_box(-length, -half, length, half)]
    if shape == "cup":
        outline = [[-r, -r], [r, -r], [r, r], [-r, r], [-r, r - t], [r - t, r - t]]
        return [[*outline, [r - t, t - r], [-r, t - r]]]
    if shape == "ring":
        return [_box(-r, -r, r, r), _box(t - r, t - r, r - t, r - t)]
    return [_box(-r, -r, r, r)]


def _box(x_min: float, y_min: float, x_max: float, y_max: float) -> Ring:
    return [[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]]
