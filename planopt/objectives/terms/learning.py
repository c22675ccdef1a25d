"""The term ``path_loss_learning``: information on the path loss from measurements on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.information import (
    Gain,
    Information,
    VarianceRemoved,
    map_criterion,
    require_estimated_path_loss,
    square_root,
)
from planopt.objectives.terms.context import NodeChannel, TermContext
from planopt.objectives.terms.measured import MeasuredTerm

LearningCriterion = Literal["T", "D", "A", "V"]


@dataclass(frozen=True)
class LearningTerm(MeasuredTerm):
    """Information on the path loss that measurements along the path give.

    All criteria rest on M_{t+h}^-1 = M_t^-1 + B' S^-1 B, which is exact. [GM11] maximises the trace
    of the increment, T, which (10 log10 d)^2 dominates, so that the robot drives to the far walls;
    D, the default, and A and V count what remains unknown. If the measurements do not identify
    theta, the posterior's weak prior is part of M_t, so that every criterion is finite.
    """

    # T (trace), D, A or V (prediction over the workspace)
    criterion: Annotated[
        LearningCriterion,
        Field(
            description="T (trace of the information), D (volume), A (variances) or V (prediction "
            "over the workspace)."
        ),
    ] = "D"

    kind: ClassVar[str] = "path_loss_learning"
    summary: ClassVar[str] = "Learn the path loss."
    task: ClassVar[str | None] = "learn"

    def gain(self, at: TermContext, posterior: ChannelPosterior) -> Gain:
        """Return the gain of the criterion over measuring nowhere (equations 4.1 and 4.2)."""
        if self.criterion == "T":
            return VarianceRemoved(np.eye(2), universal=False)
        require_estimated_path_loss(posterior)
        if self.criterion == "D":
            return Information("path loss", factor=2.0)
        spread = posterior.theta_covariance
        if self.criterion == "A":
            return VarianceRemoved(spread)
        return VarianceRemoved(spread @ square_root(map_criterion(posterior, at.region)))

    def node_gain(self, station: NodeChannel, posterior: ChannelPosterior) -> NDArray[np.float64]:
        """Return the trace for T, and the information of D for all others."""
        trend, covariance = station.trend, posterior.theta_covariance
        spread = np.einsum("yxi,ij,yxj->yx", trend, covariance, trend)
        latent = np.maximum(station.deviation_db**2 - spread, 1e-12)
        if self.criterion == "T":
            return np.einsum("yxi,yxi->yx", trend, trend) / latent
        return np.log1p(spread / latent)
