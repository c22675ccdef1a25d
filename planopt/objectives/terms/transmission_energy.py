"""The term ``transmission_energy``: energy of sending some bits at every step, subtracted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from planopt.objectives.terms.term import Structure, Term


@dataclass(frozen=True)
class TransmissionEnergyTerm(Term):
    """Expected energy of sending some bits at the end of every step, a cost.

    Attributes
    ----------
    weight
        Factor in the sum of terms, per joule; the energy is subtracted.
    bits, bandwidth_hz
        Bits a step, and symbols a second.
    bits_per_symbol, bit_error_rate, noise_dbm
        As in :class:`planopt.objectives.energy.Radio`.
    """

    bits: Annotated[float, Field(gt=0, le=1e15, description="Bits sent at the end of each step.")]
    bandwidth_hz: Annotated[float, Field(ge=1e-3, le=1e12, description="Symbols per second.")]
    bits_per_symbol: Annotated[
        float,
        Field(default=2.0, gt=0, le=16, description="Of the M-ary QAM, R in bit/s/Hz."),
    ]
    bit_error_rate: Annotated[
        float, Field(default=1e-6, gt=0, lt=0.2, description="That the power must keep.")
    ]
    noise_dbm: Annotated[float, Field(ge=-500, le=500, description="Noise of the receiver in dBm.")]

    kind: ClassVar[str] = "transmission_energy"
    summary: ClassVar[str] = "Send where it takes little power."

    @property
    def structure(self) -> Structure:
        """Steps add up."""
        return "stagewise"

    @property
    def needs_power(self) -> bool:
        """The gain of the link decides."""
        return True
