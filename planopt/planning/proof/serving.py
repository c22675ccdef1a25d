"""What a connection rests on, where not on one normal power: several stations, calibrated laws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connection.connection_law import ConnectionLaw
from planopt.channel.connection.serving_power import Laws, any_probability, serving_prediction
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction


@dataclass(frozen=True, eq=False)
class Serving:
    """What is believed of stations, each of which may connect.

    Attributes
    ----------
    posteriors
        Of each station's channel.
    thresholds_dbm
        From which power on each connects; predictions are judged by the first.
    p_min
        The bound's probability.
    """

    posteriors: tuple[ChannelPosterior, ...]
    thresholds_dbm: tuple[float, ...]
    p_min: float

    @property
    def laws(self) -> Laws:
        """Each station's calibrated law of connection; None where its power is normal."""
        return tuple(connection_law(posterior) for posterior in self.posteriors)

    def law(self, predictions: Sequence[Prediction]) -> Prediction:
        """What stands for the serving power, from predictions of each station's power."""
        return serving_prediction(predictions, self.thresholds_dbm, self.p_min, self.laws)

    def probability(self, positions_m: NDArray[np.float64], slack_db: float) -> NDArray[np.float64]:
        """P(any) at places (n, 2) with all thresholds lowered by a slack; ``(n,)``."""
        each = [posterior.predict(positions_m) for posterior in self.posteriors]
        return any_probability(each, self.thresholds_dbm, slack_db, self.laws)


def connection_law(posterior: ChannelPosterior) -> ConnectionLaw | None:
    """Return the calibrated law of a station's connection; None where its power is normal."""
    return None if posterior.outcomes is None else posterior.outcomes.law
