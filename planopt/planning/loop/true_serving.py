"""The true power that decides whether a robot is connected."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.connection.serving_power import serving_power_dbm
from planopt.channel.fields.truth import Truth, true_power_dbm
from planopt.problems.problem import Problem


def true_serving_dbm(
    problem: Problem, truths: Sequence[Truth], positions_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The serving station's true power at places (n, 2), for the first one's threshold; ``(n,)``.

    The power itself of a single station
    (:mod:`planopt.channel.connection.serving_power`). A robot is connected where it is at least
    ``problem.stations[0].true_threshold_dbm``.
    """
    powers = np.stack([true_power_dbm(truth, positions_m) for truth in truths])
    return serving_power_dbm(powers, [radio.true_threshold_dbm for radio in problem.stations])
