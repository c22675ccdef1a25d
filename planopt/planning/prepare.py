"""Prepare a run: ground truth, first measurements and initial belief of a problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from planopt.channel.belief import Belief
from planopt.channel.fields.truth import Truth
from planopt.channel.measurements import Measurements
from planopt.channel.one_thread import one_blas_thread
from planopt.planning.given import draw
from planopt.planning.loop.learn import learn_stations
from planopt.problems.problem import Problem


@dataclass(frozen=True)
class Prepared:
    """Ground truth, first measurements and belief of one seed."""

    truth: Truth | None  # The channel as it is; None if the problem has none
    belief: Belief  # What the first measurements tell
    further: tuple[Truth, ...] = ()  # The channels of further stations as they are

    @property
    def truths(self) -> tuple[Truth, ...]:
        """Return the ground truth of each station; empty if the problem has none."""
        return () if self.truth is None else (self.truth, *self.further)


@one_blas_thread()
def prepare(
    problem: Problem, seed: int, measurements: Sequence[Measurements] | None = None
) -> Prepared:
    """Draw the truth, take or read the first measurements, fit the channel, condition on them."""
    given = draw(problem, seed, measurements)
    return Prepared(given.truth, learn_stations(problem, given), given.truths[1:])
