"""What a plan is made and judged under, besides the problem and the posterior."""

from __future__ import annotations

from dataclasses import dataclass

from planopt.channel.posterior import ChannelPosterior
from planopt.planning.history import BEGINNING, History
from planopt.planning.moving import obstacles_ahead
from planopt.planning.proof.broad_prediction import BroadPrediction, broad_prediction
from planopt.problems.problem import Problem
from planopt.world.moving_discs import NOTHING_MOVES, MovingDiscs


@dataclass(frozen=True, eq=False)
class Circumstances:
    """What a plan is made and judged under.

    Attributes
    ----------
    moving
        What moves during the steps.
    history
        What has happened on the run before: rules over the whole run count it.
    broad
        What the bound rests on where all parameters are to count as uncertain.
    """

    moving: MovingDiscs = NOTHING_MOVES
    history: History = BEGINNING
    broad: BroadPrediction | None = None


NOTHING_ELSE = Circumstances()
"""Nothing moves, nothing has happened, and the posterior says all."""


def circumstances_of(
    problem: Problem,
    posterior: ChannelPosterior,
    history: History = BEGINNING,
    moving: MovingDiscs | None = None,
) -> Circumstances:
    """The circumstances of the step after `history`.

    Parameters
    ----------
    problem, posterior
        What is asked, and what is believed of the channel.
    history
        What has happened before.
    moving
        What moves; None for the problem's moving obstacles alone.
    """
    if moving is None:
        moving = obstacles_ahead(problem, history.steps)
    return Circumstances(moving, history, broad_prediction(problem, posterior))
