"""The term ``transmission_energy``: energy of sending some bits at every step, subtracted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.channel.places import require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction
from planopt.errors import InputError
from planopt.objectives.terms.context import NearPath, Paths, StepContext
from planopt.objectives.terms.term import Structure, Term
from planopt.targets.rounding import Derivatives

WATT_PER_MILLIWATT = 1e-3
NEPERS_PER_DB = math.log(10.0) / 10.0


@dataclass(frozen=True)
class Radio:
    """An M-ary QAM link that always sends just strongly enough."""

    bits_per_symbol: float  # R, spectral efficiency in bit/s/Hz
    bit_error_rate: float  # BER that is to be kept, below 0.2
    noise_dbm: float  # Receiver noise
    reference_transmit_dbm: float  # The transmit power that the channel's K_PL is for
    send_s: float  # How long it sends at each place

    def __post_init__(self) -> None:
        if not 0.0 < self.bit_error_rate < 0.2:
            raise InputError(
                f"{self.bit_error_rate!r} is out of range", key="bit_error_rate", remedy="0 to 0.2"
            )
        if not self.bits_per_symbol > 0.0:
            raise InputError(
                f"{self.bits_per_symbol!r} is not positive",
                key="bits_per_symbol",
                remedy="give bits for each symbol, such as 2",
            )

    @property
    def k_b(self) -> float:
        """K_b = -1.5 / ln(5 BER)."""
        return -1.5 / math.log(5.0 * self.bit_error_rate)


def expected_transmit_power_w(
    mean_db: NDArray[np.float64], deviation_db: NDArray[np.float64], radio: Radio
) -> NDArray[np.float64]:
    """E[P_T] = (2^R - 1) / K_b E[1 / CNR], the power that keeps the bit error rate; as `mean_db`.

    CNR is the ratio of channel to noise for one milliwatt sent. Power in dB is Gaussian, so
    E[1 / CNR] = exp((ln 10 / 10)^2 sigma^2 / 2) / CNR(mean). There is no greatest transmit power
    here: deep fades are paid in full.
    """
    cnr_db = mean_db - radio.reference_transmit_dbm - radio.noise_dbm
    inverse = np.exp(0.5 * (NEPERS_PER_DB * deviation_db) ** 2 - NEPERS_PER_DB * cnr_db)
    return WATT_PER_MILLIWATT * (2.0**radio.bits_per_symbol - 1.0) / radio.k_b * inverse


def transmission_stage_costs_j(
    posterior: ChannelPosterior, positions_m: NDArray[np.float64], settings: Radio
) -> NDArray[np.float64]:
    """Energy that sending from each of `positions_m` (n, 2) is expected to take; ``(n,)``."""
    prediction = posterior.predict(require_places(positions_m))
    return settings.send_s * expected_transmit_power_w(
        prediction.mean_db, prediction.deviation_db, settings
    )


def transmission_derivatives(
    mean_db: Derivatives, deviation_db: Derivatives, settings: Radio
) -> Derivatives:
    """Expected energy of sending at each of n places, with gradient and Hessian by the place.

    f = c exp(a^2 sigma^2 / 2 - a mu), a = ln 10 / 10, has df = f g, g = a^2 sigma dsigma - a dmu,
    and d2f = f (g g' + a^2 (dsigma dsigma' + sigma d2sigma) - a d2mu).
    """
    a = NEPERS_PER_DB
    sigma = deviation_db.value[:, None]
    energy = settings.send_s * expected_transmit_power_w(
        mean_db.value, deviation_db.value, settings
    )
    slope = a * a * sigma * deviation_db.gradient - a * mean_db.gradient
    bend = a * a * sigma * deviation_db.hessian - a * mean_db.hessian
    for first, scale in ((slope, 1.0), (deviation_db.gradient, a * a)):
        bend = bend + scale * first[:, [0, 0, 1]] * first[:, [0, 1, 1]]
    return Derivatives(energy, energy[:, None] * slope, energy[:, None] * bend)


def transmission_energy_j(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], settings: Radio
) -> float:
    """Energy that sending at each place of `path_m` (h, 2) is expected to take."""
    return float(transmission_stage_costs_j(posterior, path_m, settings).sum())


@dataclass(frozen=True)
class TransmissionEnergyTerm(Term):
    """Expected energy of sending some bits at the end of every step, a cost."""

    bits: Annotated[float, Field(gt=0, le=1e15, description="Bits sent at the end of each step.")]
    bandwidth_hz: Annotated[float, Field(ge=1e-3, le=1e12, description="Symbols per second.")]
    # As in :class:`planopt.objectives.terms.transmission_energy.Radio`
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
