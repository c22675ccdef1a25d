"""The single integrator q+ = q + h v with speed limit.

The way within a step is straight.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def dynamics_defect_m(
    positions_m: NDArray[np.float64], start_m: NDArray[np.float64], step_length_m: float
) -> float:
    """Largest violation of the motion model over a path (n + 1, 2), in metres.

    The path must begin where the robot is, and no step may be longer than the speed allows.
    """
    lengths = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    jump = float(np.linalg.norm(positions_m[0] - start_m))
    # NumPy's maximum: Python's would lose a NaN.
    return float(np.max(lengths - step_length_m, initial=jump))
