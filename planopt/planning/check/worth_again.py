"""What a path is worth, from saved files: the objective that a plan of several terms must say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.mapping import Region
from planopt.planning.proof.circumstances import Circumstances
from planopt.planning.worth.aim import Aim
from planopt.planning.worth.path_worth import PathWorth
from planopt.planning.worth.situation import Situation
from planopt.planning.worth.steering_way import SteeringWay
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex


def worth_again(
    problem: Problem,
    posterior: ChannelPosterior,
    path_m: NDArray[np.float64],
    aim: Aim,
    region: Region,
    circumstances: Circumstances,
    index: ObstacleIndex,
) -> float:
    """The weighted sum of the terms.

    Parameters
    ----------
    problem
        With one robot.
    posterior
        What was believed when the plan was made.
    path_m
        ``(N + 1, 2)`` the path, the robot's own place first.
    aim
        What it was made for.
    region
        Where the map is wanted.
    circumstances
        What else was known then.
    index
        The obstacles.
    """
    steering = None
    if aim.steering_turns_m is not None:
        steering = SteeringWay(aim.steering_turns_m, index, problem.constraints.clearance_m)
    at = Situation(
        problem,
        posterior,
        path_m[0],
        aim.target_m,
        region,
        steering,
        aim.information,
        circumstances=circumstances,
        pending=aim.pending,
    )
    return PathWorth(at)(path_m[1:])
