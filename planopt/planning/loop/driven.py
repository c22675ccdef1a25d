"""What a robot drove, from the plans whose first steps it took."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planopt.planning.plan import Plan
from planopt.problems.robot import Robot
from planopt.robots.drive import Drive


def driven(robot: Robot, plans: Sequence[Plan]) -> Drive | None:
    """States and inputs of a run, the first step of each plan; None for the single integrator.

    A run of no step has the state that it starts in.
    """
    dynamics = robot.dynamics
    if dynamics is None:
        return None
    if not plans:
        return Drive(dynamics, robot.start_state[None], np.zeros((0, len(dynamics.input_names))))
    drives = [plan.drive for plan in plans if plan.drive is not None]
    if len(drives) < len(plans):
        return None
    states = [drives[0].states[0], *(drive.states[1] for drive in drives)]
    return Drive(drives[0].dynamics, np.array(states), np.array([d.inputs[0] for d in drives]))
