"""The radio network of a snapshot service: what a frame carries, what it costs, how long it takes.

Costs are those of the whole network's state with every mote far from the edges, which is a little
more than a grid with edges sends.
"""

from __future__ import annotations

from dataclasses import dataclass

from planopt.pursuit.flooding import mean_blocks_per_frame
from planopt.pursuit.service import (
    HOPS_PER_ROUND,
    MAX_LEVELS,
    SnapshotService,
    require_count,
    require_number,
    slots_per_frame,
)


@dataclass(frozen=True)
class MoteNetwork:
    """Motes and their radios."""

    levels: int  # L: there are 4^L motes
    mote_spacing_m: float  # Distance between neighbours
    bit_rate_bit_s: float  # R: what a slot carries in its width
    # Bits of a frame beside its blocks, and of a block beside the position in it
    header_bits: float
    record_bits: float
    energy_j_per_bit: float  # What a sent bit costs, with those who hear it
    idle_w: float = 0.0  # What a mote draws all the time
    # eta_s: slots of a TDMA frame, at least those of a colouring
    slots_per_frame: int = slots_per_frame()
    # Blocks that a slot must carry. Six is the mean load; slots so short break rounds
    # (:func:`planopt.pursuit.flooding.simulate_flooding`), so that what keeps them is asked for
    # here.
    slot_blocks: int = 6
    border_relays: bool = True  # Whether motes at the border of nine cells send records on

    def __post_init__(self) -> None:
        require_count(self.levels, "levels", 1, MAX_LEVELS)
        for key in ("mote_spacing_m", "bit_rate_bit_s", "energy_j_per_bit"):
            require_number(getattr(self, key), key, above=0.0)
        for key in ("header_bits", "record_bits", "idle_w"):
            require_number(getattr(self, key), key, least=0.0)
        require_count(self.slots_per_frame, "slots_per_frame", slots_per_frame())
        require_count(self.slot_blocks, "slot_blocks", 1)

    @property
    def motes(self) -> int:
        """N."""
        return 4**self.levels

    @property
    def mean_blocks(self) -> float:
        """Blocks that a mote sends in a frame, on average."""
        return mean_blocks_per_frame(self.border_relays, self.levels)

    def block_bits(self, bits_per_axis: float) -> float:
        """Return m = m_0 + 2 c."""
        return self.record_bits + 2.0 * bits_per_axis

    def frame_bits(self, bits_per_axis: float) -> float:
        """Return what a mote sends in a frame on average, header and blocks."""
        return self.header_bits + self.mean_blocks * self.block_bits(bits_per_axis)

    def least_slot_s(self, bits_per_axis: float) -> float:
        """Return the width of a slot that carries header and `slot_blocks` blocks."""
        payload = self.header_bits + self.slot_blocks * self.block_bits(bits_per_axis)
        return payload / self.bit_rate_bit_s

    def power_w(
        self, slot_width_s: float, bits_per_axis: float, rate_divisor: float = 1.0
    ) -> float:
        """Return what the network draws; with r > 1 motes sleep in all but every r-th round."""
        lasts_s = self.slots_per_frame * slot_width_s * rate_divisor
        sent_w = self.energy_j_per_bit * self.frame_bits(bits_per_axis) / lasts_s
        return self.motes * (sent_w + self.idle_w)

    def service(
        self, slot_width_s: float, bits_per_axis: int, rate_divisor: int = 1
    ) -> SnapshotService:
        """Return the service that runs on it."""
        return SnapshotService(
            self.levels,
            self.mote_spacing_m,
            self.slots_per_frame * slot_width_s,
            bits_per_axis,
            HOPS_PER_ROUND,
            rate_divisor,
        )

    def staleness_per_slot(self, evader_speed_m_s: float) -> float:
        """Return x / s_w at r = 1, ``12 eta_s v_e`` a mote spacing; in 1/s."""
        frames = 4.0 * HOPS_PER_ROUND * self.slots_per_frame
        return frames * evader_speed_m_s / self.mote_spacing_m
