"""Terms that reward the information gain of measurements: ``path_loss_learning``, ``mapping``."""

from dataclasses import dataclass, fields
from functools import partial, reduce
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from planopt.arrays import Floats
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.objectives.information import (
    Gain,
    Information,
    PathUncertainty,
    VarianceRemoved,
    map_criterion,
    require_estimated_path_loss,
    square_root,
)
from planopt.objectives.moments import known_places, posterior_moments
from planopt.objectives.path_derivatives import PathDerivatives, by_positions, slope_by_positions
from planopt.objectives.terms.distance import SteeredTerm
from planopt.objectives.terms.term import (
    NearPath,
    NodeChannel,
    Nodes,
    Part,
    Paths,
    Steers,
    Term,
    TermContext,
    TermSetting,
)
from planopt.objectives.upper_bounds import Field as DiscField
from planopt.objectives.upper_bounds import (
    Measured,
    StageBounds,
    UpperBounds,
    closeness_bounds,
    constant_bounds,
    information_bounds,
)


@dataclass(frozen=True)
class MeasuredTerm(Term):
    """Base class of terms that reward measurements, summed over independent stations."""

    @property
    def is_measured(self) -> bool:
        """Return True, as the value is the gain of measurements."""
        return True

    def gain(self, at: TermContext, posterior: ChannelPosterior) -> Gain:
        """Return the model that computes the gain by measurements of one station."""
        raise self._without("gain")

    def node_gain(self, station: NodeChannel, posterior: ChannelPosterior) -> Floats:
        """Return the gain of a single measurement at each node as an array ``(ny, nx)``."""
        raise self._without("node_gain")

    def _gain(self, at: TermContext, number: int) -> Gain:
        """Return the gain model of station `number`, cached for the planning step."""
        posterior = at.anticipated[number]
        return at.once((MeasuredTerm, self, number), lambda: self.gain(at, posterior))

    def value(self, at: TermContext, path_m: Floats) -> float:
        """Return the gain by measurements along one path, from the exact posterior."""
        taken = at.measuring.takes(path_m)
        if not taken.any():
            return 0.0
        total = 0.0
        for number, station in enumerate(at.anticipated):
            region = known = None
            if self.averages_map:
                region = at.near_region
                if station.has_factor:
                    known = at.once(
                        (MeasuredTerm, "map", number), partial(known_places, station, region.grid_m)
                    )
            moments = posterior_moments(station, path_m, taken, region, known)
            total += float(self._gain(at, number).value(moments))
        return total

    def values(self, paths: Paths) -> Floats:
        """Return the gains by measurements along many paths, from local channel models."""
        each = [self._gain(paths.at, k).value(own.moments) for k, own in enumerate(paths.measured)]
        return np.sum(each, axis=0)

    def slope(self, paths: Paths) -> Floats:
        """Return the gradients of :meth:`values` w.r.t. the positions of paths."""
        each = [self._gain(paths.at, k).slope(own) for k, own in enumerate(paths.measured)]
        return slope_by_positions(np.sum(each, axis=0), paths.gates)

    def derivatives(self, path: NearPath) -> Part:
        """Return the value and derivatives of one path, using the local channel."""
        found = [self._gain(path.at, k).derivatives(local) for k, local in enumerate(path.measured)]
        return by_positions(reduce(PathDerivatives.plus, found), path.gates)

    def node_reward(self, at: TermContext, nodes: Nodes) -> Floats:
        """Return the gain (ny, nx) of a single measurement at each node, summed over stations."""
        near = nodes.grid_m[nodes.window]
        found = np.sum(
            [
                self.node_gain(
                    station if posterior is now else _anticipated(station, posterior, nodes, near),
                    posterior,
                )
                for station, now, posterior in zip(
                    nodes.stations, at.law.posteriors, at.anticipated, strict=True
                )
            ],
            axis=0,
        )
        # Nodes near earlier measurements yield no gain.
        is_open = np.ones(found.shape, dtype=np.bool_)
        is_open[nodes.window] = at.near_measuring.is_open(near.reshape(-1, 2)).reshape(
            near.shape[:2]
        )
        found[~is_open] = 0.0
        return found


@dataclass(frozen=True, eq=False)
class _Anticipated:
    """Lattice predictions of a station that include other robots' planned measurements."""

    mean_db: Floats
    deviation_db: Floats
    trend: Floats


def _anticipated(
    station: NodeChannel, posterior: ChannelPosterior, nodes: Nodes, near_m: Floats
) -> _Anticipated:
    known = np.isfinite(station.deviation_db[nodes.window])
    spread = np.full(known.shape, np.nan)
    if known.any():
        spread[known] = posterior.predict(near_m[known]).deviation_db
    deviation = station.deviation_db.copy()
    deviation[nodes.window] = spread
    return _Anticipated(station.mean_db, deviation, station.trend)


LearningCriterion = Literal["T", "D", "A", "V"]


@dataclass(frozen=True)
class LearningTerm(MeasuredTerm):
    """Information gain on the path loss from measurements along the path.

    All criteria use the exact update M_{t+h}^-1 = M_t^-1 + B' S^-1 B. [GM11] maximises the trace of
    the increment (T). The term (10 log10 d)^2 dominates it, so the robot drives to the far walls.
    D (default), A and V measure the remaining uncertainty instead. If the measurements do not
    identify theta, the weak prior in M_t keeps every criterion finite.
    """

    criterion: Annotated[
        LearningCriterion,
        Field(
            description="T (trace of the information), D (volume), A (variances) or V (prediction "
            "over the workspace)."
        ),
    ] = "D"

    kind: ClassVar[str] = "path_loss_learning"
    summary: ClassVar[str] = "Information on the path loss."
    task: ClassVar[str | None] = "learn"

    def gain(self, at: TermContext, posterior: ChannelPosterior) -> Gain:
        """Return the gain model for the term's criterion (equations 4.1 and 4.2)."""
        if self.criterion == "T":
            return VarianceRemoved(np.eye(2), universal=False)
        require_estimated_path_loss(posterior)
        if self.criterion == "D":
            return Information("path loss", factor=2.0)
        spread = posterior.theta_covariance
        if self.criterion == "A":
            return VarianceRemoved(spread)
        return VarianceRemoved(spread @ square_root(map_criterion(posterior, at.region)))

    def stage_bounds(self, at: TermContext) -> StageBounds | str:
        """Return upper bounds with one station; of criterion T, an own one for a single step."""
        if len(at.law.posteriors) > 1:
            return "without a proven bound for several stations"
        [posterior] = at.anticipated
        form = map_criterion(posterior, at.region) if self.criterion == "V" else np.eye(2)
        return StageBounds(
            lambda stage, field: field["trend"].positive_part(),
            most_steps=1 if self.criterion == "T" else 0,
            measured=Measured(posterior, self.criterion, form),
        )

    def node_gain(self, station: NodeChannel, posterior: ChannelPosterior) -> Floats:
        """Return each node's gain: the trace for criterion T, else information in nats."""
        trend, covariance = station.trend, posterior.theta_covariance
        spread = np.einsum("yxi,ij,yxj->yx", trend, covariance, trend)
        latent = np.maximum(station.deviation_db**2 - spread, 1e-12)
        if self.criterion == "T":
            return np.einsum("yxi,yxi->yx", trend, trend) / latent
        return np.log1p(spread / latent)


MappingForm = Literal["two_layer", "path", "information", "average"]

FORMS_WITH_KEYS: tuple[MappingForm, ...] = ("path", "two_layer")
"""Forms that weight the variance above a threshold by distance (J_CH)."""
FORM_KEYS = ("variance_threshold_db2", "closeness_per_m")  # Keys that only `FORMS_WITH_KEYS` accept

Nonnegative = Annotated[float, Field(ge=0, le=1e6)]


@dataclass(frozen=True)
class MappingTerm(MeasuredTerm):
    """Reduction of the channel's uncertainty by measurements along the path."""

    form: Annotated[
        MappingForm,
        Field(
            description="two_layer (drive to the most uncertain position), path (uncertainty along "
            "the path, near positions preferred), information (in nats), or average (variance "
            "over the workspace)."
        ),
    ] = "information"
    variance_threshold_db2: Annotated[
        Nonnegative,
        Field(description="Variance in dB^2 below which a position counts as known (sigma_TH^2)."),
    ] = 0.0
    closeness_per_m: Annotated[
        Nonnegative,
        Field(description="Preference for near positions: zeta in 1/m of the factor exp(-zeta d)."),
    ] = 0.0

    kind: ClassVar[str] = "mapping"
    summary: ClassVar[str] = "Information on the channel over the workspace."
    task: ClassVar[str | None] = "map"

    @classmethod
    def table_fault(cls, given: frozenset[str], term: Term) -> str | None:
        """Return the conflict of threshold or closeness with the form; None without conflict."""
        for key in FORM_KEYS:
            if key in given & term.left_out:
                return f'has {key}, which applies only with form = "path" or "two_layer"'
        return None

    @property
    def left_out(self) -> frozenset[str]:
        """Return the keys unused by this form."""
        return frozenset() if self.form in FORMS_WITH_KEYS else frozenset(FORM_KEYS)

    def planned(self, setting: TermSetting) -> Term:
        """Return the term used in planning; the two-layer form is replaced by a progress term."""
        if self.form != "two_layer" or isinstance(self, TwoLayerTerm):
            return self
        return TwoLayerTerm(**{each.name: getattr(self, each.name) for each in fields(self)})

    @property
    def averages_map(self) -> bool:
        """Return whether the value is an average over the map, as for the form ``average``."""
        return self.form == "average"

    @property
    def variance_threshold(self) -> float | None:
        """Variance threshold of forms that use J_CH, in dB^2; None for the others."""
        return self.variance_threshold_db2 if self.form in FORMS_WITH_KEYS else None

    @property
    def steers(self) -> Steers | None:
        """Return ``variance`` for the two-layer form, which steers to the maximum of J_CH."""
        return "variance" if self.form == "two_layer" else None

    def check(self, setting: TermSetting) -> None:
        """Raise an InputError for the two-layer form with several stations."""
        if self.form == "two_layer" and setting.stations > 1:
            raise InputError(
                'is "two_layer", which supports only one station, but the problem has '
                f"{setting.stations}",
                key="form",
                remedy='use form = "information", "average" or "path", or keep only one entry of '
                "stations",
            )

    def gain(self, at: TermContext, posterior: ChannelPosterior) -> Gain:
        """Return the gain model for the term's form (equations 4.4 to 4.6)."""
        if self.form == "path":
            x, y = (float(each) for each in at.position_m)
            return PathUncertainty((x, y), self.variance_threshold_db2, self.closeness_per_m)
        return Information() if self.form == "information" else VarianceRemoved()

    def stage_bounds(self, at: TermContext) -> StageBounds | str:
        """Return upper bounds of the forms ``path`` and ``information`` with one station.

        Earlier positions of the path only reduce variances given the measurements. Path lengths
        are at least the distances from the robot.
        """
        if len(at.law.posteriors) > 1:
            return "without a proven bound for several stations"
        if self.form not in ("path", "information"):
            return f"without a proven bound for form = {self.form}; path and information have one"
        if self.form == "information":
            [posterior] = at.anticipated
            noise = posterior.parameters.multipath_std_db**2
            return StageBounds(
                lambda stage, field: information_bounds(field["variance_db2"], noise),
                measured=Measured(posterior),
            )

        def reward(stage: int, field: DiscField) -> UpperBounds:
            near = closeness_bounds(self.closeness_per_m, at.position_m, field.discs)
            least = constant_bounds(field.discs, -self.variance_threshold_db2)
            return field["variance_db2"].plus(least).positive_part().times(near)

        return StageBounds(reward)

    def node_gain(self, station: NodeChannel, posterior: ChannelPosterior) -> Floats:
        """Return the gain of one measurement at each node; the variance for form ``average``."""
        variance = station.deviation_db**2
        match self.form:
            case "path":
                return np.maximum(variance - self.variance_threshold_db2, 0.0)
            case "information":
                floor = max(posterior.parameters.multipath_std_db, 1e-6)
                return np.log(station.deviation_db / floor)
            case _:
                return variance


@dataclass(frozen=True)
class TwoLayerTerm(SteeredTerm, MappingTerm):
    """Progress to the position of the largest J_CH (equation 4.3), instead of measurements."""

    @property
    def is_measured(self) -> bool:
        """Return False, as the value is a sum of distances."""
        return False
