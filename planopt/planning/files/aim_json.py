"""What a plan was made for, as JSON: the expected target, and where to steer to."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from planopt.planning.files.solution_json import Number, Record, finite_list
from planopt.planning.worth.aim import Aim

Place = Annotated[list[Number], Field(min_length=2, max_length=2)]


class AimRecord(Record):
    """Where the target was expected after each step, and where to steer to, if anywhere.

    `steering_turns_m` is the way there, its start and its end included. `pending_m` has the places
    of each plan of another robot that was counted.
    """

    target_x_m: list[Number] | None
    target_y_m: list[Number] | None
    steering_m: Place | None
    steering_turns_m: Annotated[list[Place], Field(min_length=2)] | None = None
    pending_m: list[list[Place]] = Field(default=[])


def aim_json(aim: Aim) -> dict[str, Any]:
    """The aim of one plan; null where there is none."""
    x, y = (None, None) if aim.target_m is None else aim.target_m.T
    turns = aim.steering_turns_m
    return {
        "target_x_m": None if x is None else finite_list(x),
        "target_y_m": None if y is None else finite_list(y),
        "steering_m": None if turns is None else finite_list(turns[-1]),
        "steering_turns_m": None if turns is None else [finite_list(turn) for turn in turns],
        "pending_m": [[finite_list(place) for place in path] for path in aim.pending.planned_m],
    }


def aim_again(record: AimRecord, watched: Aim) -> Aim:
    """The aim as it must be: what is `watched` as found again, the rest as it stands."""
    turns = record.steering_turns_m
    planned = tuple(np.array(path, dtype=np.float64).reshape(-1, 2) for path in record.pending_m)
    return replace(
        watched,
        steering_turns_m=None if turns is None else np.array(turns),
        pending=replace(watched.pending, planned_m=planned),
    )
