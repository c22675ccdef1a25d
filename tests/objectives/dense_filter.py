"""The station's filter by 4 by 4 matrices, an oracle for the filter along one axis."""

import numpy as np

MEASURES = {
    "trace": np.trace,
    "determinant": np.linalg.det,
    "norm": lambda matrix: np.linalg.norm(matrix, 2),
}


def dense_covariances(received, settings):
    """P_1 .. P_k ``(k, 4, 4)`` for the information of packets per axis ``(k,)``."""
    a, q = settings.model.transition, settings.model.process_covariance
    spread, found = np.linalg.inv(settings.information), []
    for information in received:
        spread = a @ spread @ a.T + q
        matrix = np.linalg.inv(spread)
        matrix[:2, :2] += information * np.eye(2)
        spread = np.linalg.inv(matrix)
        found.append(spread)
    return np.array(found)


def dense_costs(received, settings):
    """f(P_k) of the position after each step; ``(k,)``."""
    measure = MEASURES[settings.criterion]
    return np.array([measure(each[:2, :2]) for each in dense_covariances(received, settings)])
