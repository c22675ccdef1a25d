"""The term ``mapping``: uncertainty of the channel that measurements on the way remove."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.objectives.batch_derivatives import PathDerivatives
from planopt.objectives.mapping import (
    Uncertainty,
    average_reduction,
    path_information,
    path_uncertainty,
    path_uncertainty_derivatives,
)
from planopt.objectives.path_loss_learning import (
    average_reduction_derivatives,
    path_information_derivatives,
)
from planopt.objectives.steered import (
    gained_derivatives,
    gained_m,
    gained_reward,
    gained_slope,
    gains_m,
)
from planopt.objectives.terms.context import (
    NearPath,
    NearStation,
    NodeChannel,
    Nodes,
    Part,
    Paths,
    StepContext,
    legs_m,
)
from planopt.objectives.terms.measured import added, added_derivatives, measured_reward
from planopt.objectives.terms.term import Steers, Structure, Term, TermSetting
from planopt.objectives.told_batch import (
    Pull,
    ToldBatch,
    kernel_slopes,
    pull_of_legs,
    trend_of_universal,
)

MappingForm = Literal["two_layer", "path", "information", "average"]

FORMS_WITH_KEYS: tuple[MappingForm, ...] = ("path", "two_layer")
"""The forms that weigh the variance above a threshold by its distance (J_CH)."""

FORM_KEYS = ("variance_threshold_db2", "closeness_per_m")
"""The keys that only these have."""

Nonnegative = Annotated[float, Field(ge=0, le=1e6)]


@dataclass(frozen=True)
class MappingTerm(Term):
    """Uncertainty of the channel that measurements along the path remove."""

    # two_layer (steer to the maximiser of J_CH), path (J_CH summed along the path), information or
    # average (over the workspace)
    form: Annotated[
        MappingForm,
        Field(
            description="two_layer (steer to the most uncertain place), path (uncertainty of the "
            "places along the path, near ones preferred), information (in nats), or "
            "average (variance over the workspace)."
        ),
    ] = "information"
    # sigma_TH^2 in dB^2
    variance_threshold_db2: Annotated[
        Nonnegative,
        Field(description="Variances up to this count as none, sigma_TH^2 in dB^2."),
    ] = 0.0
    # zeta of psi(d) = exp(-zeta d)
    closeness_per_m: Annotated[
        Nonnegative,
        Field(description="zeta of exp(-zeta d), in 1/m: how much near places are preferred."),
    ] = 0.0

    kind: ClassVar[str] = "mapping"
    summary: ClassVar[str] = "Map the channel."
    task: ClassVar[str | None] = "map"

    @classmethod
    def table_fault(cls, given: frozenset[str], term: Term) -> str | None:
        """Threshold and closeness are keys of two forms only."""
        for key in FORM_KEYS:
            if key in given & term.left_out:
                return f'has {key}, which goes only with form = "path" and "two_layer"'
        return None

    @property
    def left_out(self) -> frozenset[str]:
        """The keys that other forms have."""
        return frozenset() if self.form in FORMS_WITH_KEYS else frozenset(FORM_KEYS)

    @property
    def structure(self) -> Structure:
        """Only distances to the steering place add up over the steps."""
        return "stagewise" if self.form == "two_layer" else "full"

    @property
    def is_measured(self) -> bool:
        """The two-layer form counts distances, the others measurements."""
        return self.form != "two_layer"

    @property
    def averages_map(self) -> bool:
        """The form ``average`` does."""
        return self.form == "average"

    @property
    def variance_threshold(self) -> float | None:
        """Forms of J_CH have one."""
        return self.variance_threshold_db2 if self.form in FORMS_WITH_KEYS else None

    @property
    def steers(self) -> Steers | None:
        """The two-layer form steers to the place of the largest J_CH."""
        return "variance" if self.form == "two_layer" else None

    def check(self, setting: TermSetting) -> None:
        """The two-layer form is for one station."""
        if self.form == "two_layer" and setting.stations > 1:
            raise InputError(
                f"two_layer steers by one station's map, and there are {setting.stations}",
                key="form",
                remedy="information, average or path, or leave one entry of stations",
            )

    def settings(self, at: StepContext) -> Uncertainty:
        """Return threshold and closeness from where the robot is."""
        x, y = at.position_m
        return Uncertainty(
            self.variance_threshold_db2, self.closeness_per_m, start_m=(float(x), float(y))
        )

    def value(self, at: StepContext, path_m: NDArray[np.float64]) -> float:
        """Return what the measurements along one path tell of the map, or the metres gained."""
        if self.form == "two_layer":
            return gained_m(at, path_m)
        taken = at.measuring.takes(path_m)
        if not taken.any():
            return 0.0
        if self.form == "path":
            settings = self.settings(at)
            return sum(path_uncertainty(p, path_m, settings, taken) for p in at.anticipated)
        measured = path_m[taken]
        if self.form == "information":
            return sum(path_information(station, measured) for station in at.anticipated)
        return sum(
            average_reduction(station, measured, at.near_region, known)
            for station, known in zip(at.anticipated, at.near_places, strict=True)
        )

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return the same of many paths."""
        if self.form != "two_layer":
            return added(self._told(paths.at, told) for told in paths.told)
        return gains_m(paths)

    def _told(self, at: StepContext, told: ToldBatch) -> NDArray[np.float64]:
        """Return what the measurements of one station tell."""
        if self.form == "path":
            excess, near = self._path_parts(at, told)
            return (excess * near).sum(axis=1)
        if self.form == "information":
            diagonal = np.diagonal(told.factor, axis1=1, axis2=2)
            return np.log(diagonal / np.sqrt(told.noise_db2)).sum(axis=1)
        # sum_g w_g c(g)' S^-1 c(g), theta uncertain (equation 4.6), as tr(S^-1 C C') with
        # C C' small: solving for C itself would cost several times as much.
        across = told.across
        gathered = across @ across.transpose(0, 2, 1)
        return np.trace(np.linalg.solve(told.universal, gathered), axis1=1, axis2=2)

    def _path_parts(
        self, at: StepContext, told: ToldBatch
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the part of L_ii^2 above the threshold, and psi of the way there; ``(c, N)``."""
        settings = self.settings(at)
        length = np.cumsum(legs_m(at, told.batch.ways_m), axis=1)
        return told.above_db2(settings.threshold_db2), np.exp(-settings.decay_per_m * length)

    def derivatives(self, path: NearPath) -> Part:
        """Return the value of one path near the channel of its start."""
        if self.form == "two_layer":
            return gained_derivatives(path)
        return added_derivatives(self._informed(path, near) for near in path.told)

    def _informed(self, path: NearPath, near: NearStation) -> PathDerivatives:
        channel, places, gates = near.channel, path.places_m, path.gates
        if self.form == "path":
            return path_uncertainty_derivatives(channel, places, self.settings(path.at), gates)
        if self.form == "information":
            return path_information_derivatives(channel, places, gates=gates)
        return average_reduction_derivatives(channel, near.required_grid, places, gates=gates)

    def slope(self, at: StepContext, told: ToldBatch, station: ChannelPosterior) -> Pull:
        """Return derivatives of :meth:`values` by what one station's measurements tell."""
        if self.form == "two_layer":
            return gained_slope(at, told.batch)
        if self.form == "path":
            return self._path_slope(at, told)
        return _information_slope(told) if self.form == "information" else _average_slope(told)

    def _path_slope(self, at: StepContext, told: ToldBatch) -> Pull:
        """L_ii^2 changes by L_ii^2 n_i' dS n_i, n_i row i of L^-1."""
        settings = self.settings(at)
        excess, near = self._path_parts(at, told)
        variance = np.diagonal(told.factor, axis1=1, axis2=2) ** 2
        rows = np.linalg.inv(told.factor)
        counts = np.where(excess > 0.0, near, 0.0)
        weight = variance * counts
        found = _by_universal(told, rows.transpose(0, 2, 1) @ (weight[:, :, None] * rows))
        if told.gate is not None:
            fall = 2.0 * told.gate * (settings.threshold_db2 - told.blind_db2)
            found = found.plus(Pull(by_gate=fall * counts), -1.0)
        # A leg is in the way to its own place and to all after it.
        after = np.cumsum((excess * near)[:, ::-1], axis=1)[:, ::-1]
        legs = pull_of_legs(at.position_m, told.batch.ways_m, -settings.decay_per_m * after)
        return found.plus(legs, 1.0)

    def node_reward(self, at: StepContext, nodes: Nodes) -> NDArray[np.float64]:
        """Return what measuring at each node alone would tell, or minus the distance to go."""
        if self.form != "two_layer":
            return measured_reward(at, nodes, self._node_told)
        return gained_reward(at, nodes)

    def _node_told(self, station: NodeChannel, posterior: ChannelPosterior) -> NDArray[np.float64]:
        variance = station.deviation_db**2
        match self.form:
            case "path":
                return np.maximum(variance - self.variance_threshold_db2, 0.0)
            case "information":
                floor = max(posterior.parameters.multipath_std_db, 1e-6)
                return np.log(station.deviation_db / floor)
            case _:
                return variance


def _by_universal(told: ToldBatch, by_universal: NDArray[np.float64]) -> Pull:
    """Return the slope by S_g + B_g M B_g' (c, N, N), symmetric."""
    by_trend = trend_of_universal(told.trend, told.batch.channel, by_universal)
    return told.pulled_back(Pull(by_covariance=by_universal, by_trend=by_trend))


def _information_slope(told: ToldBatch) -> Pull:
    """Return half the inverse by S; what fills a gated measurement up is no information."""
    found = _by_universal(told, 0.5 * told.inverse)
    if told.gate is None:
        return found
    noise = told.batch.channel.parameters.multipath_std_db**2
    fills = told.gate * (noise - told.blind_db2) / told.noise_db2
    return found.plus(Pull(by_gate=fills), -1.0)


def _average_slope(told: ToldBatch) -> Pull:
    """Return the slope of the average: with X = S^-1 C, -X X' by S and 2 X by C."""
    batch, grid = told.batch, told.grid
    distance, kernel, across = batch.across
    x = (told.inverse.astype(np.float32) @ told.across).astype(np.float32)
    by_covariance = -(x @ x.transpose(0, 2, 1)).astype(np.float64)
    by_gate = None
    if told.gate is not None:
        by_gate = 2.0 * (x * across).sum(axis=2, dtype=np.float64)
        x *= told.gate.astype(np.float32)[:, :, None]
    by_across = (2.0 * x * grid.root_weight.astype(np.float32)).reshape(kernel.shape)
    by_trend = (by_across @ grid.trend.astype(np.float32)).astype(np.float64)
    by_trend = by_trend.reshape(*batch.shape, 2) @ batch.channel.theta_covariance
    by_phi = np.zeros_like(batch.solved)
    by_phi -= (by_across @ grid.solved.T.astype(np.float32)).reshape(by_phi.shape)
    by_place = kernel_slopes(batch.ways_m, grid.positions_m, batch, by_across, distance, kernel)
    found = _by_universal(told, by_covariance)
    return found.plus(Pull(by_place, None, by_trend, by_phi, by_gate), 1.0)
