"""The tables ``[objective]`` and ``[[targets]]`` of a problem file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planopt.problems.objective import (
    CostToGo,
    LearningCriterion,
    LearningTerm,
    MappingForm,
    MappingTerm,
    MotionEnergyTerm,
    ReachObjective,
    Term,
    TrackingForm,
    TrackingTerm,
)
from planopt.problems.schema_terms import (
    CasadiTable,
    TransmissionEnergyTable,
    UntilConnectedTable,
    Weight,
)
from planopt.problems.tables import Name, Pair, Table
from planopt.problems.target import Target

FORMS_WITH_KEYS: tuple[MappingForm, ...] = ("path", "two_layer")
"""The forms of mapping that look at J_CH."""

FORM_KEYS = ("variance_threshold_db2", "closeness_per_m")
"""The keys of a mapping term that only these have."""

LEAST_STD = 1e-6
"""Of a first estimate in metres or m/s: its information is still a number that can be inverted."""

Deviation = Annotated[float, Field(ge=0, le=1e6)]


class TrackingTable(Table):
    """A term: what the packets that reach the station tell of the target."""

    kind: Literal["tracking"] = Field(description="Track a target over a lossy link.")
    weight: Weight = Field(default=1.0, description="In the sum of terms.")
    noise_curvature: float = Field(
        gt=0,
        le=1e9,
        description="c of the sensor's variance at r metres: "
        "c (r - sweet_spot_m)^2 + noise_floor_m2.",
    )
    noise_floor_m2: float = Field(gt=0, le=1e9, description="Variance in m^2 at the best distance.")
    sweet_spot_m: float = Field(
        ge=0, le=1e6, description="Distance in metres at which the sensor is best."
    )
    form: TrackingForm = Field(
        default="additive",
        description="additive (P(connected) over the variance, summed over steps), or by the "
        "station's filter: information (an upper bound), covariance (losses as if independent in "
        "time) or sampled (joint losses).",
    )

    @property
    def term(self) -> Term:
        """The plain term."""
        return TrackingTerm(
            self.weight,
            self.noise_curvature,
            self.noise_floor_m2,
            self.sweet_spot_m,
            self.form,
        )


class LearningTable(Table):
    """A term: information on path loss that the measurements on the way give."""

    kind: Literal["path_loss_learning"] = Field(description="Learn the path loss.")
    weight: Weight = Field(default=1.0, description="In the sum of terms.")
    criterion: LearningCriterion = Field(
        default="D",
        description="T (trace of the information), D (volume), A (variances) or V (prediction "
        "over the workspace).",
    )

    @property
    def term(self) -> Term:
        """The plain term."""
        return LearningTerm(self.weight, self.criterion)


class MappingTable(Table):
    """A term: uncertainty of the channel that the measurements on the way remove."""

    kind: Literal["mapping"] = Field(description="Map the channel.")
    weight: Weight = Field(default=1.0, description="In the sum of terms.")
    form: MappingForm = Field(
        default="information",
        description="two_layer (steer to the most uncertain place), path (uncertainty of the "
        "places along the path, near ones preferred), information (in nats), or "
        "average (variance over the workspace).",
    )
    variance_threshold_db2: Deviation = Field(
        default=0.0, description="Variances up to this count as none, sigma_TH^2 in dB^2."
    )
    closeness_per_m: Deviation = Field(
        default=0.0, description="zeta of exp(-zeta d), in 1/m: how much near places are preferred."
    )

    @model_validator(mode="after")
    def _keys_of_the_form(self) -> MappingTable:
        for key in FORM_KEYS:
            if key in self.model_fields_set and self.form not in FORMS_WITH_KEYS:
                raise PydanticCustomError(
                    "one_of",
                    'has {key}, which goes only with form = "path" and "two_layer"',
                    {"key": key},
                )
        return self

    @property
    def term(self) -> Term:
        """The plain term."""
        return MappingTerm(
            self.weight, self.form, self.variance_threshold_db2, self.closeness_per_m
        )


class MotionEnergyTable(Table):
    """A term: energy of motion, subtracted."""

    kind: Literal["motion_energy"] = Field(description="Spare energy.")
    weight: Weight = Field(default=1.0, description="In the sum of terms, per joule.")
    per_metre_j_m: float = Field(ge=0, le=1e9, description="k1 in J/m.")
    power_w: float = Field(default=0.0, ge=0, le=1e9, description="k2 in W while moving.")

    @property
    def term(self) -> Term:
        """The plain term."""
        return MotionEnergyTerm(self.weight, self.per_metre_j_m, self.power_w)


TermTable = Annotated[
    TrackingTable
    | LearningTable
    | MappingTable
    | MotionEnergyTable
    | UntilConnectedTable
    | TransmissionEnergyTable
    | CasadiTable,
    Field(discriminator="kind"),
]


class ObjectiveTable(Table):
    """``[objective]``: to reach a goal, time plus effort; for other tasks a sum of terms."""

    effort_weight_s2_m2: float = Field(
        default=ReachObjective.effort_weight_s2_m2,
        ge=0,
        le=1e6,
        description="Weight of speed squared in the cost rate 1 + weight * speed^2, in s^2/m^2.",
    )
    cost_to_go: CostToGo = Field(
        default=ReachObjective.cost_to_go,
        description="Beyond the horizon: geodesic (shortest path round the obstacles) or connected "
        "(cheapest path at the outage price).",
    )
    outage_price: float = Field(
        default=ReachObjective.outage_price,
        ge=0,
        le=1e6,
        description="A metre driven where the probability of connection P is below p_min counts "
        "1 + outage_price (1 - P) metres (a number). constraints.slack_max_db = 0 forbids it.",
    )
    terms: list[TermTable] = Field(
        default=[],
        description="For tasks other than reach: the weighted sum to be maximised; the first term "
        "is the task's.",
    )


class TargetTable(Table):
    """``[[targets]]``: a moving target and what is known of it at the start."""

    name: Name = Field(default=Target.name, description="What outputs call it.")
    start_m: Pair = Field(description="Where it truly starts, [x, y] in metres.")
    velocity_m_s: Pair = Field(description="Its true velocity at the start, [x, y] in m/s.")
    acceleration_std_m_s2: Deviation = Field(
        default=Target.acceleration_std_m_s2,
        description="Deviation of its white acceleration along an axis, in m/s^2.",
    )
    position_std_m: float = Field(
        default=Target.position_std_m,
        ge=LEAST_STD,
        le=1e6,
        description="Deviation of its first estimated position, in m.",
    )
    velocity_std_m_s: float = Field(
        default=Target.velocity_std_m_s,
        ge=LEAST_STD,
        le=1e6,
        description="Deviation of its first estimated velocity, in m/s.",
    )

    @property
    def target(self) -> Target:
        """The plain target."""
        return Target(**self.model_dump())
