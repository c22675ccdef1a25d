"""Moves of agents toward their targets in one step: by laws, or by a plan over a horizon."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.control.laws import Gains, law_moves
from planopt.coverage.control.radio import radio_tree
from planopt.coverage.control.receding import plan_moves, stopping_ways
from planopt.coverage.ground import Ground
from planopt.coverage.limits import MoveLimits, RadioLimits


@dataclass(frozen=True, eq=False)
class Motion:
    """Places, velocities and headings of agents."""

    places_m: NDArray[np.float64]  # (n, 2)
    velocities_m_s: NDArray[np.float64]  # (n, 2) velocities at the end of the last step
    headings_rad: NDArray[np.float64]  # (n,); they matter for unicycles alone


class Mover(Protocol):
    """The law by which agents move toward their targets in one step."""

    def __call__(
        self,
        ground: Ground,
        motion: Motion,
        targets_m: NDArray[np.float64],
        responds: NDArray[np.bool_],
        drifts_m_s: NDArray[np.float64],
    ) -> Motion:
        """Return where agents are after the step, and how they move then.

        Targets move at velocities `drifts_m_s` (n, 2) as far as agents have estimated that.
        """
        ...


@dataclass(frozen=True)
class LawMover:
    """Drives by the laws, with the speed clipped."""

    gains: Gains  # As for :func:`planopt.coverage.control.laws.law_moves`
    time_step_s: float
    speed_m_s: float | None

    def __call__(
        self,
        ground: Ground,
        motion: Motion,
        targets_m: NDArray[np.float64],
        responds: NDArray[np.bool_],
        drifts_m_s: NDArray[np.float64],
    ) -> Motion:
        """Return where agents are after a step of the laws."""
        here, gains = motion.places_m, self.gains
        moved = law_moves(here, targets_m, responds, gains, self.time_step_s, self.speed_m_s)
        return Motion(moved, (moved - here) / self.time_step_s, motion.headings_rad)


@dataclass(frozen=True)
class RecedingMover:
    """Plans over a horizon with the targets held, and drives the first move."""

    gains: Gains  # As for :func:`planopt.coverage.control.receding.plan_moves`
    limits: MoveLimits
    horizon: int
    # Links to base stations that agents keep over a tree; None for none
    radio: RadioLimits | None = None
    # Whether plans follow targets that move; else targets are held over the horizon
    lead: bool = False

    def __call__(
        self,
        ground: Ground,
        motion: Motion,
        targets_m: NDArray[np.float64],
        responds: NDArray[np.bool_],
        drifts_m_s: NDArray[np.float64],
    ) -> Motion:
        """Return where agents are after the first move of a plan."""
        step_s, kept = self.limits.time_step_s, None
        most = self.limits.acceleration_m_s2
        if self.radio is not None:
            stops = motion.places_m
            if most is not None:
                stops = stops + stopping_ways(motion.velocities_m_s * step_s, most * step_s**2)
            kept = radio_tree(motion.places_m, self.radio, stops).kept
        moves = plan_moves(
            ground,
            motion.places_m,
            targets_m,
            self.limits,
            self.gains.shares(responds, step_s) / step_s,
            self.horizon,
            velocities_m_s=motion.velocities_m_s,
            headings_rad=motion.headings_rad,
            kept=kept,
            target_velocities_m_s=drifts_m_s if self.lead else None,
        )
        if most is not None:
            velocities = moves.velocities_m_s[:, 1]
        else:
            velocities = (moves.next_m - motion.places_m) / step_s
        turned = motion.headings_rad if moves.headings_rad is None else moves.headings_rad
        return Motion(moves.next_m, velocities, turned)
