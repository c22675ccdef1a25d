"""What random problems may have besides: rules of connectivity, dynamics, what moves, distances.

Drawn from a stream of its own, so that the scene of a seed stays what it is without them.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np

Tables = dict[str, Any]

POLISHING = ("auto", "auto", "nlp", "scp", "lattice")
"""Planners of robots that have dynamics."""


def with_more(tables: Tables, generator: np.random.Generator) -> Tables:
    """A copy of a problem's tables with some of it."""
    wide = deepcopy(tables)
    speed = float(wide["robots"][0]["speed_max_m_s"])
    step_s = float(wide["planner"]["step_s"])
    if generator.uniform() < 0.6 and wide["constraints"]["p_min"] > 0.0:
        _rule(wide, generator, speed * step_s)
    if generator.uniform() < 0.5:
        _dynamics(wide, generator)
    if generator.uniform() < 0.4:
        _moving(wide, generator, speed)
    if len(wide["robots"]) > 1 and generator.uniform() < 0.5:
        wide["constraints"]["separation_m"] = float(speed * step_s * generator.choice([0.3, 1.0]))
    if wide["problem"]["task"] != "reach" and generator.uniform() < 0.3:
        wide["objective"]["terms"].append(_term(generator, speed * step_s))
    if generator.uniform() < 0.1:
        wide["planner"]["budget_s"] = float(generator.choice([0.002, 0.02]))
    return wide


def _rule(tables: Tables, generator: np.random.Generator, step_m: float) -> None:
    """A rule of connectivity, hard or with slack."""
    own, step_s = tables["constraints"], tables["planner"]["step_s"]
    run_s = tables["planner"]["max_steps"] * step_s
    rule = str(generator.choice(["each_step", "stated", "average", "joint", "outage", "data"]))
    own["connectivity"] = "each_step" if rule == "stated" else rule
    if rule == "stated":
        steps = (
            1 + generator.permutation(tables["planner"]["max_steps"])[: generator.integers(1, 5)]
        )
        own["connected_times_s"] = [float(step * step_s) for step in np.sort(steps)]
    elif rule == "outage":
        if generator.uniform() < 0.5:
            own["outage_max_m"] = float(step_m * generator.choice([0.0, 1.5, 5.0]))
        else:
            own["outage_max_s"] = float(step_s * generator.choice([0.0, 1.0, 4.0]))
    elif rule == "data":
        own["rate_mbit_s"] = 2.0
        own["deadline_s"] = float(run_s * generator.choice([0.5, 1.0]))
        own["data_mbit"] = float(2.0 * own["deadline_s"] * generator.choice([0.1, 0.5, 0.95]))
        own["p_min"] = float(generator.choice([0.0, own["p_min"]]))
    elif generator.uniform() < 0.2 and rule == "each_step":
        own["parameter_uncertainty"] = "all"
    if generator.uniform() < 0.4:
        own["slack_max_db"] = float(generator.choice([0.0, 3.0, 30.0]))
        if own["slack_max_db"] > 0.0 and tables["problem"]["task"] != "reach":
            own["slack_price"] = float(generator.choice([0.0, 0.1, 10.0]))


def _dynamics(tables: Tables, generator: np.random.Generator) -> None:
    """Robots that cannot stop or turn at will, from sluggish to nimble."""
    step_s = tables["planner"]["step_s"]
    for robot in tables["robots"]:
        kind = str(generator.choice(["single_integrator", "double_integrator", "unicycle"]))
        robot["dynamics"] = kind
        if kind == "double_integrator":
            share = float(generator.choice([0.2, 0.5, 2.0]))
            robot["acceleration_max_m_s2"] = share * robot["speed_max_m_s"] / step_s
        elif kind == "unicycle":
            robot["turn_rate_max_rad_s"] = float(generator.choice([0.2, 0.8, 2.5])) / step_s
            robot["start_heading_rad"] = float(generator.uniform(-np.pi, np.pi))
            robot["speed_min_m_s"] = float(generator.choice([0.0, -0.3])) * robot["speed_max_m_s"]
    if tables["planner"]["name"] not in POLISHING:
        tables["planner"]["name"] = str(generator.choice(POLISHING))


def _moving(tables: Tables, generator: np.random.Generator, speed_m_s: float) -> None:
    """One to three discs, some of them as fast as a robot, some uncertain."""
    bounds = np.asarray(tables["world"]["bounds_m"])
    size = bounds[2:] - bounds[:2]
    discs: list[Tables] = []
    for number in range(int(generator.integers(1, 4))):
        disc: Tables = {
            "name": f"disc_{number}",
            "radius_m": float(size.min() * generator.uniform(0.01, 0.08)),
            "start_m": generator.uniform(bounds[:2], bounds[2:]).tolist(),
            "velocity_m_s": (speed_m_s * generator.uniform(-1.0, 1.0, 2)).tolist(),
        }
        if generator.uniform() < 0.3:
            disc["position_std_m"] = float(0.1 * disc["radius_m"])
        discs.append(disc)
    tables["world"]["moving"] = discs


def _term(generator: np.random.Generator, step_m: float) -> Tables:
    """A term of another kind."""
    if generator.uniform() < 0.5:
        return {"kind": "until_connected", "weight": float(1.0 / step_m)}
    return {
        "kind": "motion_energy",
        "weight": float(10.0 ** generator.uniform(-3.0, 0.0)),
        "per_metre_j_m": 1.0,
    }
