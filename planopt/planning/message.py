"""What keeps a plan from being all that was asked, in words for people."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.certificate import Certificate
from planopt.planning.tolerances import STANDSTILL_M


def plan_message(certificate: Certificate, positions_m: NDArray[np.float64]) -> str:
    """Say what is wrong with a path (N + 1, 2), the robot's own place first; empty if all is well.

    Parameters
    ----------
    certificate
        What the verifier says of it.
    positions_m
        The path.
    """
    parts = list(certificate.reasons)
    rule = certificate.rule
    if rule is not None and rule.slack_db > 0.0:
        if not parts:
            parts.append(
                f"connectivity ({rule.connectivity}) is kept with a slack of {rule.slack_db:.2f} dB"
            )
    elif certificate.relaxed_steps and not parts:
        worst = max(certificate.relaxation_db)
        steps = ", ".join(map(str, certificate.relaxed_steps))
        path_m, best_m = certificate.path_cost_m, certificate.best_cost_m
        if path_m is None or best_m is None:
            parts.append(
                f"the connectivity bound cannot be met from here at steps {steps}; "
                f"it is missed by up to {worst:.2f} dB"
            )
        else:
            parts.append(
                f"steps {steps} miss the connectivity bound by up to {worst:.2f} dB: with them the "
                f"way to the goal costs {path_m:.1f} m, metres out of contact at their price, the "
                f"cheapest found {best_m:.1f} m"
            )
    if np.linalg.norm(positions_m[1:] - positions_m[0], axis=1).max() <= STANDSTILL_M:
        parts.append("the plan stands still")
    return "; ".join(parts)
