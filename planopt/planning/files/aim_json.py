"""What a plan was made for, as JSON: the expected target, and where to steer to."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import Field

from planopt.planning.files.solution_json import Number, Record, finite_list
from planopt.planning.worth.aim import Aim


class AimRecord(Record):
    """Where the target was expected after each step, and where to steer to, if anywhere."""

    target_x_m: list[Number] | None
    target_y_m: list[Number] | None
    steering_m: list[Number] | None = Field(min_length=2, max_length=2)


def aim_json(aim: Aim) -> dict[str, Any]:
    """The aim of one plan; null where there is none."""
    x, y = (None, None) if aim.target_m is None else aim.target_m.T
    return {
        "target_x_m": None if x is None else finite_list(x),
        "target_y_m": None if y is None else finite_list(y),
        "steering_m": None if aim.steering_m is None else finite_list(aim.steering_m),
    }


def aim_again(record: AimRecord, watched: Aim) -> Aim:
    """The aim as it must be: what is `watched` as found again, the steering as it stands."""
    steering = record.steering_m
    return replace(watched, steering_m=None if steering is None else np.array(steering))
