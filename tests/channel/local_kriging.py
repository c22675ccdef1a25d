"""Prediction from a neighbour model, as its docstring says it is: one place a centre, by loops."""

import numpy as np

from planopt.channel.nearest.neighbours import NeighbourModel
from planopt.channel.parameters import regressors
from planopt.channel.prediction import Prediction


def predict_locally(model: NeighbourModel, positions_m: np.ndarray) -> Prediction:
    """Mean and deviation at ``positions_m`` (k, 2), each from its own centre's measurements."""
    parameters = model.parameters
    shadow, multipath = parameters.shadow_std_db**2, parameters.multipath_std_db**2
    mean, variance = [], []
    for k, place in enumerate(positions_m):
        squared = ((model.positions_m[k] - place) ** 2).sum(axis=1) + model.blur_m2[k]
        phi = shadow * np.exp(-np.sqrt(squared) / parameters.decorrelation_m)
        gamma = regressors(place, parameters.station)
        mean.append(gamma @ model.theta + phi @ (model.weights[k] - model.trend[k] @ model.theta))
        b = gamma - model.trend[k].T @ phi
        latent = max(shadow - phi @ model.precision[k] @ phi, 0.0)
        variance.append(latent + multipath + b @ model.theta_covariance @ b)
    return Prediction(np.array(mean), np.sqrt(variance))
