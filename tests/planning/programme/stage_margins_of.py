"""Margins of the stages of one set of neighbours, at a single path."""

from __future__ import annotations

import numpy as np

from planopt.channel.kriging import LocalChannel
from planopt.objectives.stage_power import StagePredictor
from planopt.planning.programme.evaluation import margins_of
from planopt.targets.rounding import Derivatives


def stage_margins(
    model: LocalChannel, positions_m: np.ndarray, threshold_dbm: float, z: float | np.ndarray
) -> Derivatives:
    """Margin of each stage k at ``positions_m[k]``, from the model's k-th neighbour set."""
    return margins_of(*StagePredictor(model)(positions_m), threshold_dbm, z)
