"""Saved plans and runs of the former file format, brought into today's; for one version.

Format 1 had no key ``format``, and a form of its own for the one robot of a problem that is to
reach a goal: plans of a run without the robot's name, and the way on to the goal beside the robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from planopt.planning.files.saved import FORMAT, PLAN_FILE

OWN_PLAN_KEYS = (
    *("termination", "verdict", "objective", "wall_s", "solve_s", "iterations", "certificate"),
    *("rung", "lattice_objective", "polish_gain", "message"),
)
"""Keys of a plan that its robot has as well."""

ON_THE_WAY = ("pivot", "route", "holes")
"""Keys of a plan to a goal that stood beside its robot."""

OWN_METRICS = ("path_m", "true_connected_share", "longest_outage_m", "measured_steps")
"""Metrics of a run that its robots have as well."""

NO_AIM = dict.fromkeys(("target_x_m", "target_y_m", "steering_m", "steering_turns_m"))

Table = dict[str, Any]


def without_former_forms(file: Path, data: Mapping[str, Any]) -> tuple[Mapping[str, Any], bool]:
    """Return what a file says in today's form, and whether it has the former one.

    What does not have the form that it should have is left as it is, for the reader to report.
    """
    data = _decoupled(data)
    if "format" in data or not isinstance(data.get("robots"), list):
        return data, False
    table = {"format": FORMAT, **data}
    try:
        # These keys have no place in today's files; runs of teams had the form of today's.
        if "holes" not in data and (file.name == PLAN_FILE or _reaches(table)):
            return data, False
        return (_plan if file.name == PLAN_FILE else _run)(table), True
    except (KeyError, TypeError, IndexError, AttributeError):
        # The reader names what is missing or of another kind.
        return {"format": FORMAT, **data}, True


def _decoupled(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Robots of a team counted nothing of the others' before there was a key that says so."""
    problem = data.get("problem_file")
    planner = cast("Table", problem).get("planner") if isinstance(problem, dict) else None
    if not isinstance(planner, dict) or "coordination" in planner:
        return data
    settings = {**cast("Table", planner), "coordination": "decoupled"}
    return {**data, "problem_file": {**cast("Table", problem), "planner": settings}}


def _reaches(data: Table) -> bool:
    return data["problem_file"]["problem"]["task"] == "reach"


def _plan(data: Table) -> Table:
    on_the_way = {key: data.pop(key) for key in ON_THE_WAY if key in data}
    robots = cast("list[Table]", data["robots"])
    if robots and _reaches(data):
        own = {key: data[key] for key in OWN_PLAN_KEYS}
        data["robots"] = [{**robots[0], **own, "aim": NO_AIM, **on_the_way}, *robots[1:]]
    elif len(robots) == 1:
        data["message"] = str(data["message"]).removeprefix(f"{robots[0]['name']}: ")
    return data


def _run(data: Table) -> Table:
    holes = data.pop("holes", [])
    robots = cast("list[Table]", data["robots"])
    if not robots or not _reaches(data):
        return data
    own = {key: data["metrics"][key] for key in OWN_METRICS}
    own |= {key: data[key] for key in ("rungs", "verified_rate")}
    data["robots"] = [{**robots[0], **own, "holes": holes}, *robots[1:]]
    released = [{**plan, "aim": NO_AIM} for plan in data["plans"]]
    data["plans"] = [{"robot": robots[0]["name"], "released": released}]
    return data
