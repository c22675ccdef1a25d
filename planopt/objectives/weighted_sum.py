"""Several objectives at once: named terms, weighted and added.

Everything is a value to be made large. A cost (energy, distance, covariance) enters with a
negative weight.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError

Value = Callable[[ChannelPosterior, NDArray[np.float64]], float]
"""The value of a path ``(h, 2)``: an objective with its settings bound."""

StageRewards = Callable[[ChannelPosterior, NDArray[np.float64], int], NDArray[np.float64]]
"""What each of the places ``(n, 2)`` is worth at a stage; ``(n,)``."""


@dataclass(frozen=True)
class Term:
    """One objective in a sum.

    Attributes
    ----------
    name
        As in the problem file.
    weight
        Factor; negative for a cost.
    value
        The objective with its settings bound.
    stage_rewards
        Its parts by stage, None where it is not a sum over stages.
    """

    name: str
    weight: float
    value: Value
    stage_rewards: StageRewards | None = None


@dataclass(frozen=True)
class Worth:
    """The value of a path.

    Attributes
    ----------
    total
        Sum of weight times value.
    terms
        Each term's own value, not weighted.
    """

    total: float
    terms: dict[str, float]


def weighted_sum(
    terms: Sequence[Term], posterior: ChannelPosterior, path_m: NDArray[np.float64]
) -> Worth:
    """The value of `path_m` (h, 2).

    Raises
    ------
    InputError
        There is no term, or two of the same name.
    """
    _require_terms(terms)
    values = {term.name: term.value(posterior, path_m) for term in terms}
    return Worth(sum(term.weight * values[term.name] for term in terms), values)


def weighted_stage_rewards(
    terms: Sequence[Term],
    posterior: ChannelPosterior,
    positions_m: NDArray[np.float64],
    stage: int,
) -> NDArray[np.float64]:
    """What each of `positions_m` (n, 2) is worth at `stage`, the first step being 0; ``(n,)``.

    Raises
    ------
    InputError
        A term is no sum over stages.
    """
    _require_terms(terms)
    total = np.zeros(len(positions_m))
    for term in terms:
        if term.stage_rewards is None:
            raise InputError(
                f"the objective {term.name} is no sum over stages",
                key=term.name,
                remedy="use a planner that takes any objective",
            )
        total += term.weight * term.stage_rewards(posterior, positions_m, stage)
    return total


def _require_terms(terms: Sequence[Term]) -> None:
    names = [term.name for term in terms]
    if not names or len(set(names)) < len(names):
        raise InputError(f"objectives {names} are none, or not told apart", key="objective")
