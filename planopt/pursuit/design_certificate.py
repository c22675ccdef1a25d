"""Verify the guarantee of a network: every inequality again, from its numbers alone.

Nothing of the search is used: ages, errors and loads are computed from their definitions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from planopt.pursuit.design import DesignTask
from planopt.pursuit.guarantees import Inequality, Theorem, guarantees
from planopt.pursuit.service import ServiceBounds

ROUNDING = 1e-9
"""Share by which a requirement that the optimum meets exactly may be missed through rounding."""


@dataclass(frozen=True)
class Requirement:
    """An inequality that a design must meet."""

    inequality: Inequality  # Which
    strict: bool = True  # Whether equality is a failure. Loads and margins may be met exactly.

    @property
    def holds(self) -> bool:
        """Return whether the design meets it."""
        if self.strict:
            return self.inequality.holds
        return self.inequality.left <= self.inequality.right * (1.0 + ROUNDING)

    def __str__(self) -> str:
        if self.holds and not self.inequality.holds:
            return f"{self.inequality.words}: met exactly"
        return str(self.inequality)


def certify(
    task: DesignTask,
    theorem: Theorem,
    slot_width_s: float,
    rate_divisor: int,
    bits_per_axis: int,
) -> tuple[Requirement, ...]:
    """Return every requirement on a network of these numbers, met or not."""
    network, chase = task.network, task.chase
    payload = network.header_bits + network.slot_blocks * (network.record_bits + 2 * bits_per_axis)
    found = [
        Requirement(
            Inequality(
                "payload of a slot below what it carries",
                payload,
                network.bit_rate_bit_s * slot_width_s,
                "bit",
            ),
            strict=False,
        )
    ]
    # Six frames a spacing and a rate of one: a round of three frames a cell, cells below 2 d.
    frame_s = network.slots_per_frame * slot_width_s
    age_s_m = 6.0 * (1 + rate_divisor) * frame_s / network.mote_spacing_m
    kappa = math.sqrt(2.0) / 2.0**bits_per_axis
    ratio = chase.evader_speed_m_s / chase.pursuer_speed_m_s
    a, x = ratio + kappa * (1.0 + ratio), age_s_m * chase.evader_speed_m_s
    if task.capture_radius_m is None:
        found += [
            Requirement(Inequality("a + x below 1", a + x, 1.0)),
            Requirement(Inequality("a + x + margin below 1", a + x + task.margin, 1.0), False),
        ]
        if task.deadline_s is not None and task.first_distance_m is not None:
            first_s = (1.0 + kappa) * task.first_distance_m / chase.pursuer_speed_m_s
            longest_s = first_s / (1.0 - a - x) if a + x < 1.0 else math.inf
            found.append(
                Requirement(
                    Inequality(
                        "time to capture below the deadline", longest_s, task.deadline_s, "s"
                    ),
                    strict=False,
                )
            )
        return tuple(found)
    bounds = ServiceBounds(
        age_s_m,
        kappa,
        3.0 * (1 + rate_divisor) * frame_s,
        math.sqrt(0.5) * network.mote_spacing_m,
        6.0 * rate_divisor * frame_s / network.mote_spacing_m,
    )
    guarantee = guarantees(chase, bounds)[theorem]
    found += [Requirement(each) for each in guarantee.inequalities]
    found.append(Requirement(guarantee.captures(task.capture_radius_m)))
    if task.deadline_s is not None and task.first_distance_m is not None:
        longest_s = guarantee.capture_time_s(task.first_distance_m, task.capture_radius_m)
        words = "time to capture below the deadline"
        found.append(Requirement(Inequality(words, longest_s, task.deadline_s, "s")))
    return tuple(found)
