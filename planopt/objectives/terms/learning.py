"""The term ``path_loss_learning``: information on the path loss from measurements on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.batch_derivatives import PathDerivatives
from planopt.objectives.path_loss_learning import (
    Criterion,
    goal_criterion,
    path_loss_derivatives,
    path_loss_gain,
    theta_information,
)
from planopt.objectives.terms.context import NearPath, NodeChannel, Nodes, Paths, StepContext
from planopt.objectives.terms.measured import added, added_derivatives, measured_reward
from planopt.objectives.terms.term import Term
from planopt.objectives.told_batch import Pull, ToldBatch

LearningCriterion = Literal["T", "D", "A", "V"]


@dataclass(frozen=True)
class LearningTerm(Term):
    """Information on the path loss that measurements along the path give."""

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

    @property
    def is_measured(self) -> bool:
        """The value is what measurements tell."""
        return True

    def settings(self, at: StepContext, station: ChannelPosterior) -> Criterion:
        """Return the criterion for one station."""
        if self.criterion == "V":
            return goal_criterion(station, at.region.grid_m, at.region.weight)
        return Criterion(self.criterion)

    def value(self, at: StepContext, path_m: NDArray[np.float64]) -> float:
        """Return what the measurements along one path tell of every station, added up."""
        measured = path_m[at.measuring.takes(path_m)]
        if not len(measured):
            return 0.0
        return sum(
            path_loss_gain(station, measured, self.settings(at, station))
            for station in at.anticipated
        )

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return the same of many paths."""
        return added(
            self._gain(paths.at, told, station)
            for told, station in zip(paths.told, paths.at.anticipated, strict=True)
        )

    def _gain(
        self, at: StepContext, told: ToldBatch, station: ChannelPosterior
    ) -> NDArray[np.float64]:
        criterion = self.settings(at, station)
        whitened = np.linalg.solve(told.covariance, told.trend)
        gained = told.trend.transpose(0, 2, 1) @ whitened
        before = None if criterion.kind == "T" else theta_information(station)
        return criterion.value(gained, before) - criterion.value(np.zeros((2, 2)), before)

    def derivatives(self, path: NearPath) -> PathDerivatives:
        """Return the value of one path near the channel of its start."""
        return added_derivatives(
            path_loss_derivatives(
                near.channel, path.places_m, self.settings(path.at, near.posterior), path.gates
            )
            for near in path.told
        )

    def slope(self, at: StepContext, told: ToldBatch, station: ChannelPosterior) -> Pull:
        """Return 2 X Z by B and -X Z X' by S, X = S^-1 B and Z the slope by B' S^-1 B."""
        criterion = self.settings(at, station)
        x = np.linalg.solve(told.covariance, told.trend)
        before = None if criterion.kind == "T" else theta_information(station)
        by_trend = x @ criterion.slope(told.trend.transpose(0, 2, 1) @ x, before)
        by_covariance = -by_trend @ x.transpose(0, 2, 1)
        return told.pulled_back(Pull(by_covariance=by_covariance, by_trend=2.0 * by_trend))

    def node_reward(self, at: StepContext, nodes: Nodes) -> NDArray[np.float64]:
        """Return what measuring at each node alone would tell."""
        return measured_reward(at, nodes, self._told)

    def _told(self, station: NodeChannel, posterior: ChannelPosterior) -> NDArray[np.float64]:
        trend, covariance = station.trend, posterior.theta_covariance
        spread = np.einsum("yxi,ij,yxj->yx", trend, covariance, trend)
        latent = np.maximum(station.deviation_db**2 - spread, 1e-12)
        if self.criterion == "T":
            return np.einsum("yxi,yxi->yx", trend, trend) / latent
        return np.log1p(spread / latent)
