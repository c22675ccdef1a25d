"""What a plan is made and judged under, besides the problem and the posterior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from planopt.channel.posterior import ChannelPosterior
from planopt.planning.history import BEGINNING, History
from planopt.planning.moving import obstacles_ahead
from planopt.planning.proof.broad_prediction import Broad, broad_prediction
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
        What the bound rests on where it is not the posterior alone: all parameters are to count as
        uncertain, or there are several stations.
    """

    moving: MovingDiscs = NOTHING_MOVES
    history: History = BEGINNING
    broad: Broad | None = None


NOTHING_ELSE = Circumstances()
"""Nothing moves, nothing has happened, and the posterior says all."""


def circumstances_of(
    problem: Problem,
    posteriors: Sequence[ChannelPosterior],
    history: History = BEGINNING,
    moving: MovingDiscs | None = None,
) -> Circumstances:
    """The circumstances of the step after `history`.

    Parameters
    ----------
    problem, posteriors
        What is asked, and what is believed of each station's channel.
    history
        What has happened before.
    moving
        What moves; None for the problem's moving obstacles alone.
    """
    if moving is None:
        moving = obstacles_ahead(problem, history.steps)
    return Circumstances(moving, history, broad_prediction(problem, posteriors))
