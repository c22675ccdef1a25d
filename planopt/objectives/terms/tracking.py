"""The term ``tracking``: what the packets of a path tell the station of a target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from planopt.objectives.terms.term import Structure, Term
from planopt.targets.sensor import Sensor

TrackingForm = Literal["additive", "information", "covariance", "sampled"]


@dataclass(frozen=True)
class TrackingTerm(Term):
    """What the packets of a path tell the station of the target.

    A packet sent at distance r of the target's predicted position has the information 1 / g(r),
    ``g(r) = noise_curvature (r - sweet_spot_m)^2 + noise_floor_m2``.

    Attributes
    ----------
    weight
        Factor in the sum of terms.
    noise_curvature, noise_floor_m2, sweet_spot_m
        Curvature (a number), least variance in m^2 and best distance in m of the sensor.
    form
        ``additive``: P(connected) / g(r), summed over the steps. The others follow the station's
        filter: ``information`` bounds the expected gain of information from above, ``covariance``
        removes covariance as if losses were independent in time, ``sampled`` averages over joint
        losses.
    """

    noise_curvature: Annotated[
        float,
        Field(
            gt=0,
            le=1e9,
            description="c of the sensor's variance at r metres: "
            "c (r - sweet_spot_m)^2 + noise_floor_m2.",
        ),
    ]
    noise_floor_m2: Annotated[
        float, Field(gt=0, le=1e9, description="Variance in m^2 at the best distance.")
    ]
    sweet_spot_m: Annotated[
        float, Field(ge=0, le=1e6, description="Distance in metres at which the sensor is best.")
    ]
    form: Annotated[
        TrackingForm,
        Field(
            description="additive (P(connected) over the variance, summed over steps), or by the "
            "station's filter: information (an upper bound), covariance (losses as if independent "
            "in time) or sampled (joint losses)."
        ),
    ] = "additive"

    kind: ClassVar[str] = "tracking"
    summary: ClassVar[str] = "Track a target over a lossy link."
    task: ClassVar[str | None] = "track"

    @property
    def structure(self) -> Structure:
        """Steps add up in the additive form only."""
        return "stagewise" if self.form == "additive" else "full"

    @property
    def needs_power(self) -> bool:
        """A packet arrives with the probability of connection."""
        return True

    @property
    def sensor(self) -> Sensor:
        """Its variance grows away from the best distance."""
        return Sensor(self.noise_curvature, self.noise_floor_m2, self.sweet_spot_m)

    @property
    def calibration_fault(self) -> str | None:
        """Samples are drawn from the normal law."""
        if self.form == "sampled":
            return 'tracking of the form "sampled" draws from the normal law of a whole path'
        return None
