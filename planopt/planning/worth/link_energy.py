"""Energy to send from places: to the station that is expected to need the least.

Which station a robot sends to is chosen at every place beforehand, by what is believed today; with
one station there is nothing to choose.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction
from planopt.objectives.energy import expected_transmit_power_w, transmission_derivatives
from planopt.planning.worth.serving_stages import StagePower
from planopt.planning.worth.situation import Situation
from planopt.problems.objective import TransmissionEnergyTerm
from planopt.targets.rounding import Derivatives


def link_energy_j(
    term: TransmissionEnergyTerm, at: Situation, powers: Sequence[Prediction]
) -> NDArray[np.float64]:
    """Expected energy of sending at each place; as the predictions of each station's power."""
    radios = [at.radio(term, station) for station in range(len(powers))]
    least = [
        expected_transmit_power_w(power.mean_db, power.deviation_db, radio)
        for power, radio in zip(powers, radios, strict=True)
    ]
    return radios[0].send_s * (least[0] if len(least) == 1 else np.min(least, axis=0))


def link_energy_derivatives(
    term: TransmissionEnergyTerm, at: Situation, powers: Sequence[StagePower]
) -> Derivatives:
    """The same of N stages, with derivatives by the place: of the station that is chosen there."""
    each = [
        transmission_derivatives(*power, at.radio(term, station))
        for station, power in enumerate(powers)
    ]
    if len(each) == 1:
        return each[0]
    best = np.argmin([energy.value for energy in each], axis=0), np.arange(len(each[0].value))
    return Derivatives(
        np.stack([energy.value for energy in each])[best],
        np.stack([energy.gradient for energy in each])[best],
        np.stack([energy.hessian for energy in each])[best],
    )
