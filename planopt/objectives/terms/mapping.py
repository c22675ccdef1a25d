"""The term ``mapping``: uncertainty of the channel that measurements on the way remove."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from planopt.errors import InputError
from planopt.objectives.terms.term import Steers, Structure, Term, TermSetting

MappingForm = Literal["two_layer", "path", "information", "average"]

FORMS_WITH_KEYS: tuple[MappingForm, ...] = ("path", "two_layer")
"""The forms that weigh the variance above a threshold by its distance (J_CH)."""

FORM_KEYS = ("variance_threshold_db2", "closeness_per_m")
"""The keys that only these have."""

Nonnegative = Annotated[float, Field(ge=0, le=1e6)]


@dataclass(frozen=True)
class MappingTerm(Term):
    """Uncertainty of the channel that measurements along the path remove.

    Attributes
    ----------
    weight
        Factor in the sum of terms.
    form
        ``two_layer`` (steer to the maximiser of J_CH), ``path`` (J_CH summed along the path),
        ``information`` or ``average`` (over the workspace).
    variance_threshold_db2
        sigma_TH^2 in dB^2.
    closeness_per_m
        zeta of ``psi(d) = exp(-zeta d)``.
    """

    form: Annotated[
        MappingForm,
        Field(
            description="two_layer (steer to the most uncertain place), path (uncertainty of the "
            "places along the path, near ones preferred), information (in nats), or "
            "average (variance over the workspace)."
        ),
    ] = "information"
    variance_threshold_db2: Annotated[
        Nonnegative,
        Field(description="Variances up to this count as none, sigma_TH^2 in dB^2."),
    ] = 0.0
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
    def learns(self) -> bool:
        """All forms lead to places that are not known."""
        return True

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
