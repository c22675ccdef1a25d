"""The term ``transmission_energy``: energy of sending some bits at every step, subtracted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.channel.prediction import Prediction
from planopt.objectives.energy import (
    Radio,
    expected_transmit_power_w,
    transmission_derivatives,
)
from planopt.objectives.terms.context import NearPath, Paths, StepContext
from planopt.objectives.terms.term import Structure, Term
from planopt.targets.rounding import Derivatives


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

    def radio(self, transmit_power_dbm: float) -> Radio:
        """Return the settings of a link; the predicted gain is that of the station's sending."""
        return Radio(
            self.bits_per_symbol,
            self.bit_error_rate,
            self.noise_dbm,
            transmit_power_dbm,
            self.bits / (self.bits_per_symbol * self.bandwidth_hz),
        )

    def energy_j(self, at: StepContext, powers: Sequence[Prediction]) -> NDArray[np.float64]:
        """Return the expected energy of sending at each place, to the station that needs least.

        The station is chosen at every place beforehand, by what is believed today.

        Parameters
        ----------
        at
            What is known.
        powers
            Predictions of each station's power.
        """
        radios = [self.radio(power) for power in at.transmit_powers_dbm]
        least = [
            expected_transmit_power_w(power.mean_db, power.deviation_db, radio)
            for power, radio in zip(powers, radios, strict=True)
        ]
        return radios[0].send_s * (least[0] if len(least) == 1 else np.min(least, axis=0))

    def value(self, at: StepContext, path_m: NDArray[np.float64]) -> float:
        """Return minus the energy of all steps."""
        return -float(self.energy_j(at, at.powers(path_m)).sum())

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return minus the energy of all steps of each path."""
        return -self.energy_j(paths.at, paths.each).reshape(paths.shape).sum(axis=1)

    def derivatives(self, path: NearPath) -> Derivatives:
        """Return minus the energy of each step, to the station that is chosen at its place."""
        each = [
            transmission_derivatives(*power, self.radio(sent))
            for power, sent in zip(path.each, path.at.transmit_powers_dbm, strict=True)
        ]
        if len(each) == 1:
            return Derivatives(-each[0].value, -each[0].gradient, -each[0].hessian)
        best = np.argmin([energy.value for energy in each], axis=0), np.arange(len(each[0].value))
        return Derivatives(
            -np.stack([energy.value for energy in each])[best],
            -np.stack([energy.gradient for energy in each])[best],
            -np.stack([energy.hessian for energy in each])[best],
        )

    def power_reward(
        self, at: StepContext, powers: Sequence[Prediction], chance: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return minus the energy at each place."""
        return -self.energy_j(at, powers)
