"""More terms of ``[objective]``: until connected, energy of sending, expressions of one's own."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from planopt.problems.objective import CasadiTerm, Term, TransmissionEnergyTerm, UntilConnectedTerm
from planopt.problems.settings import MAX_HORIZON, MIN_HORIZON
from planopt.problems.tables import Decibels, Table

Weight = Annotated[float, Field(ge=0, le=1e9)]


class UntilConnectedTable(Table):
    """A term: expected distance until connected, subtracted."""

    kind: Literal["until_connected"] = Field(description="Find connection after a short way.")
    weight: Weight = Field(default=1.0, description="In the sum of terms, per metre.")
    beyond_m: float | None = Field(
        default=None,
        ge=0,
        le=1e6,
        description="Metres that the search is expected to go on for where the place that the "
        "robot is steered to is not connected; by default estimated from what is believed.",
    )

    @property
    def term(self) -> Term:
        """The plain term."""
        return UntilConnectedTerm(self.weight, self.beyond_m)


class TransmissionEnergyTable(Table):
    """A term: energy of sending some bits at every step, subtracted."""

    kind: Literal["transmission_energy"] = Field(description="Send where it takes little power.")
    weight: Weight = Field(default=1.0, description="In the sum of terms, per joule.")
    bits: float = Field(gt=0, le=1e15, description="Bits sent at the end of each step.")
    bandwidth_hz: float = Field(ge=1e-3, le=1e12, description="Symbols per second.")
    bits_per_symbol: float = Field(
        default=2.0, gt=0, le=16, description="Of the M-ary QAM, R in bit/s/Hz."
    )
    bit_error_rate: float = Field(
        default=1e-6, gt=0, lt=0.2, description="That the power must keep."
    )
    noise_dbm: Decibels = Field(description="Noise of the receiver in dBm.")

    @property
    def term(self) -> Term:
        """The plain term."""
        return TransmissionEnergyTerm(
            self.weight,
            self.bits,
            self.bandwidth_hz,
            self.bits_per_symbol,
            self.bit_error_rate,
            self.noise_dbm,
        )


class CasadiTable(Table):
    """A term: an objective of one's own, as planopt.casadi_term writes it."""

    kind: Literal["casadi"] = Field(description="A value of one's own, made large.")
    weight: float = Field(
        default=1.0, ge=-1e9, le=1e9, description="In the sum of terms; negative for a cost."
    )
    steps: int = Field(
        ge=MIN_HORIZON, le=MAX_HORIZON, description="The horizon that the expression is for."
    )
    program: str = Field(description="Its instructions, one a line.")

    @property
    def term(self) -> Term:
        """The plain term."""
        return CasadiTerm(self.weight, self.steps, self.program)
