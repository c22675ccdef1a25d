"""The term ``mapping``: uncertainty of the channel that measurements on the way remove."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.objectives.information import Gain, Information, PathUncertainty, VarianceRemoved
from planopt.objectives.moments import Pull
from planopt.objectives.terms.context import NearPath, NodeChannel, Nodes, Part, Paths, TermContext
from planopt.objectives.terms.goal import SteeredTerm
from planopt.objectives.terms.measured import MeasuredTerm
from planopt.objectives.terms.term import Steers, Structure, Term, TermSetting

MappingForm = Literal["two_layer", "path", "information", "average"]

FORMS_WITH_KEYS: tuple[MappingForm, ...] = ("path", "two_layer")
"""The forms that weigh the variance above a threshold by its distance (J_CH)."""

FORM_KEYS = ("variance_threshold_db2", "closeness_per_m")
"""The keys that only these have."""

DISTANCE = SteeredTerm()
"""Value of the two-layer form: distance gained towards the place that is steered to."""

Nonnegative = Annotated[float, Field(ge=0, le=1e6)]


@dataclass(frozen=True)
class MappingTerm(MeasuredTerm):
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

    def gain(self, at: TermContext, posterior: ChannelPosterior) -> Gain:
        """Return the gain of the form (equations 4.4 to 4.6)."""
        if self.form == "path":
            x, y = (float(each) for each in at.position_m)
            return PathUncertainty((x, y), self.variance_threshold_db2, self.closeness_per_m)
        return Information() if self.form == "information" else VarianceRemoved()

    def node_gain(self, station: NodeChannel, posterior: ChannelPosterior) -> NDArray[np.float64]:
        """Return the gain of the form at each node alone; the variance there for averages."""
        variance = station.deviation_db**2
        match self.form:
            case "path":
                return np.maximum(variance - self.variance_threshold_db2, 0.0)
            case "information":
                floor = max(posterior.parameters.multipath_std_db, 1e-6)
                return np.log(station.deviation_db / floor)
            case _:
                return variance

    def value(self, at: TermContext, path_m: NDArray[np.float64]) -> float:
        """Return what the measurements along one path tell of the map, or the metres gained."""
        return DISTANCE.value(at, path_m) if self.form == "two_layer" else super().value(at, path_m)

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return the same of many paths."""
        return DISTANCE.values(paths) if self.form == "two_layer" else super().values(paths)

    def derivatives(self, path: NearPath) -> Part:
        """Return the value of one path near the channel of its start."""
        return DISTANCE.derivatives(path) if self.form == "two_layer" else super().derivatives(path)

    def slope(self, paths: Paths, number: int) -> Pull:
        """Return derivatives of :meth:`values` by one station's moments, or by the places."""
        if self.form == "two_layer":
            return DISTANCE.slope(paths, number)
        return super().slope(paths, number)

    def node_reward(self, at: TermContext, nodes: Nodes) -> NDArray[np.float64]:
        """Return what measuring at each node alone would tell, or minus the distance to go."""
        if self.form == "two_layer":
            return DISTANCE.node_reward(at, nodes)
        return super().node_reward(at, nodes)
