"""What further measurements would read: by whom, when and how finely they are taken counts too."""

from __future__ import annotations

import numpy as np

from planopt.channel.intervals.sites import rounded_variance_db2
from planopt.channel.kriging import predict_noiseless
from planopt.channel.measurements import Measurements
from planopt.channel.parameter_uncertainty import MarginalPosterior, mixture
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction


def predict_readings(
    posterior: ChannelPosterior | MarginalPosterior, readings: Measurements
) -> Prediction:
    """Predict what measurements read that `posterior` has not seen.

    Parameters
    ----------
    posterior
        The channel given other measurements.
    readings
        n measurements. Their powers are not looked at; their times, receivers, resolution and
        position errors are.

    Returns
    -------
    Prediction
        In their order. Where `readings` are plain measurements, and the channel does not forget,
        that of the posterior at their positions.
    """
    if isinstance(posterior, MarginalPosterior):
        parts = [predict_readings(component, readings) for component in posterior.components]
        return mixture(posterior.weights, parts)
    found = predict_noiseless(posterior, readings)
    variance = found.deviation_db**2 + posterior.parameters.multipath_std_db**2
    variance += rounded_variance_db2(readings.resolution_db)
    return Prediction(found.mean_db, np.sqrt(variance))
