"""Information on path loss that a path gathers, in several criteria (equations 4.1 and 4.2).

All rest on M_{t+h}^-1 = M_t^-1 + B' S^-1 B, which is exact. [GM11] maximises the trace of the
increment, criterion T. That is scale dependent, (10 log10 d)^2 dominates it and the robot runs for
the far walls; D, the default, and A and V look at what is left unknown instead.

Where the measurements do not identify theta, the posterior has a weak prior on it
(:data:`planopt.channel.conditioning.WEAK_THETA_DEVIATION`). It is part of M_t and stays in the
plan, so that every criterion is finite from no measurement on.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import solve_lower
from planopt.channel.kriging import kriging_terms
from planopt.channel.places import require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.objectives.batch import Batch, batch_factor, batch_of
from planopt.objectives.weights import require_weights

Kind = Literal["T", "D", "A", "V"]


@dataclass(frozen=True, eq=False)
class Criterion:
    """How much an information matrix N = M_{t+h}^-1 is worth; more is better.

    Attributes
    ----------
    kind
        ``T``: tr(N - M_t^-1), equation (2) of [GM11]. ``D``: log det N. ``A``: -tr N^-1.
        ``V``: -tr(G N^-1).
    goal
        ``(2, 2)`` G = sum_g w_g varphi(g) varphi(g)', from :func:`goal_criterion`; read by V only.

    Raises
    ------
    InputError
        Another kind, or a goal that is no ``(2, 2)`` matrix.
    """

    kind: Kind = "D"
    goal: NDArray[np.float64] = field(default_factory=lambda: np.eye(2))

    def __post_init__(self) -> None:
        if self.kind not in ("T", "D", "A", "V"):
            raise InputError(f"{self.kind!r} is no criterion", key="kind", remedy="T, D, A or V")
        if self.goal.shape != (2, 2):
            raise InputError(f"a goal of shape {self.goal.shape} is not (2, 2)", key="goal")

    def value(
        self, gained: NDArray[np.float64], before: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """The worth of B' S^-1 B = `gained` ``(..., 2, 2)`` on top of `before` = M_t^-1.

        `before` is not read by T and may be None there.
        """
        if self.kind == "T" or before is None:
            return np.asarray(np.trace(gained, axis1=-2, axis2=-1))
        after = before + gained
        if self.kind == "D":
            return np.asarray(np.linalg.slogdet(after)[1])
        spread = np.linalg.inv(after)
        goal = np.eye(2) if self.kind == "A" else self.goal
        return np.asarray(-np.einsum("ij,...ji->...", goal, spread))

    def slope(
        self, gained: NDArray[np.float64], before: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """The derivative of :meth:`value` by `gained`, symmetric; ``(..., 2, 2)``.

        I for T, N^-1 for D, N^-1 G N^-1 for V, with G = I for A.
        """
        if self.kind == "T" or before is None:
            return np.broadcast_to(np.eye(2), gained.shape)
        spread = np.asarray(np.linalg.inv(before + gained), dtype=np.float64)
        if self.kind == "D":
            return spread
        return np.asarray(spread @ (np.eye(2) if self.kind == "A" else self.goal) @ spread)


def goal_criterion(
    posterior: ChannelPosterior, goals_m: NDArray[np.float64], weight: NDArray[np.float64]
) -> Criterion:
    """Return V, -sum_g w_g varphi(g)' M_{t+h} varphi(g): theta where it matters (equation 4.2).

    varphi(g) is today's: what theta adds to the variance at g before the path's
    own measurements are used for shadowing there.

    Parameters
    ----------
    posterior
        The channel given measurements.
    goals_m
        ``(g, 2)`` where prediction matters.
    weight
        ``(g,)`` w_g >= 0.

    Raises
    ------
    InputError
        Goals are no places, or weights are negative or of another number.
    """
    places = require_places(goals_m)
    trend = kriging_terms(posterior, places).trend
    return Criterion("V", trend.T @ (require_weights(weight, len(places))[:, None] * trend))


def path_loss_value(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], criterion: Criterion
) -> float:
    """Return the criterion's value of measuring at `path_m` (h, 2) (equations 4.1 and 4.2).

    Raises
    ------
    InputError
        `path_m` is no path; theta is known and the criterion is not T; or see
        :func:`planopt.objectives.batch.batch_factor`.
    """
    rows = _whitened_trend(batch_of(posterior, path_m))
    return float(criterion.value(rows.T @ rows, _before(posterior, criterion)))


def path_loss_gain(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], criterion: Criterion
) -> float:
    """How much more :func:`path_loss_value` is than that of measuring nowhere; 0 at least."""
    nothing = float(criterion.value(np.zeros((2, 2)), _before(posterior, criterion)))
    return path_loss_value(posterior, path_m, criterion) - nothing


def path_loss_steps(
    posterior: ChannelPosterior, path_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """``|varphi_{t+i-1}(q_i)|^2 / sigma_{t+i-1}^2(q_i)``, what each step adds to T; ``(h,)``."""
    return (_whitened_trend(batch_of(posterior, path_m)) ** 2).sum(axis=1)


def path_loss_one_step(
    posterior: ChannelPosterior, positions_m: NDArray[np.float64], criterion: Criterion
) -> NDArray[np.float64]:
    """The value of a path of one step to each of `positions_m` (n, 2), together; ``(n,)``.

    For T it is ``|varphi(q)|^2 / sigma^2(q)`` with sigma^2 as if theta were known, as in [GM11].
    """
    terms = kriging_terms(posterior, require_places(positions_m))
    gained = terms.trend[:, :, None] * terms.trend[:, None, :]
    gained /= terms.variance_db2[:, None, None]
    return criterion.value(gained, _before(posterior, criterion))


def theta_information(posterior: ChannelPosterior) -> NDArray[np.float64]:
    """``(2, 2)`` M_t^-1, the weak prior in it where the posterior has it.

    Raises
    ------
    InputError
        Theta is known: there is nothing to learn.
    """
    if posterior.theta_known:
        raise InputError(
            "path loss is known: no path can teach anything about it",
            key="theta",
            remedy="condition the channel with theta='estimated'",
        )
    return np.asarray(np.linalg.inv(posterior.theta_covariance), dtype=np.float64)


def _before(posterior: ChannelPosterior, criterion: Criterion) -> NDArray[np.float64] | None:
    return None if criterion.kind == "T" else theta_information(posterior)


def _whitened_trend(batch: Batch) -> NDArray[np.float64]:
    """L^-1 B, whose Gram matrix is B' S^-1 B; ``(h, 2)``."""
    return solve_lower(batch_factor(batch.covariance_db2), batch.trend)
