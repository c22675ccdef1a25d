"""Values that no channel has, and logs that look as if a floor had been taken for powers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters

PLAUSIBLE_N_PL = (1.0, 6.0)
"""From waveguides to the densest buildings; free space is 2."""

EXTENT_SHARE = 1.0 / 3.0
"""A decorrelation distance beyond this share of the log's extent is hardly seen in it: the places
that far apart are few, and shadowing cannot be told from path loss."""

PLAUSIBLE_POWER_DBM = (-200.0, 100.0)
"""Thermal noise in 1 Hz is -174 dBm; 100 dBm are ten megawatts."""

LEAST_PILE = 5
"""Fewer equal lowest powers are no pile."""

PILE_RATIO = 2.0
"""A pile is one that is this many times as high as any other: powers that were rounded coincide
too, but most in the middle of their range."""

PILE_NEIGHBOURS = 3
PILE_CHANCE = 1e-3
"""Or it is one where its height, against the highest of the next few values, has no larger
probability than this: towards the end of a range values become rarer, not more frequent."""


def implausible_values(
    parameters: ChannelParameters, measurements: Measurements, extent_m: float
) -> tuple[str, ...]:
    """Say which values are not to be believed.

    Parameters
    ----------
    parameters
        An estimate; its path loss exponent may be assumed.
    measurements
        What it is of.
    extent_m
        Diagonal of the bounding box of their positions.
    """
    said: list[str] = []
    low, high = PLAUSIBLE_POWER_DBM
    for power in (measurements.power_dbm.min(), measurements.power_dbm.max()):
        if not low <= power <= high:
            said.append(
                f"a power of {power:g} dBm is implausible ({low:g} to {high:g} dBm): "
                "check the unit and the column"
            )
    low, high = PLAUSIBLE_N_PL
    n_pl = parameters.n_pl
    if n_pl < 0.0:
        said.append("n_PL is negative: power grows with the distance to the station")
    elif not low <= n_pl <= high:
        said.append(f"n_PL of {n_pl:.2f} is implausible ({low:g} to {high:g})")
    beta = parameters.decorrelation_m
    if beta > EXTENT_SHARE * extent_m:
        said.append(
            f"a decorrelation distance of {beta:.3g} m is implausible: the log spans "
            f"{extent_m:.3g} m, so that shadowing cannot be told from path loss"
        )
    return tuple(said)


def suspected_floor(measurements: Measurements) -> str | None:
    """Say that the lowest power occurs suspiciously often without being censored; None if not."""
    exact = measurements.power_dbm[~measurements.censored]
    values, counts = np.unique(exact, return_counts=True)
    if len(values) < 2 or not _is_pile(counts):
        return None
    return (
        f"the lowest power, {values[0]:g} dBm, occurs {counts[0]} times among {len(exact)}: it "
        f"looks like the receiver's floor, and biases the fit if it is; mark such powers as "
        f"censored (--floor={values[0]:g})"
    )


def _is_pile(counts: NDArray[np.intp]) -> bool:
    """Whether the first of the counts of ascending values is too high for the end of a range."""
    pile, beside = int(counts[0]), int(counts[1 : 1 + PILE_NEIGHBOURS].max())
    if pile < LEAST_PILE:
        return False
    # Where values become rarer it has at most half of both.
    chance = float(bdtrc(pile - 1, pile + beside, 0.5))
    return pile > PILE_RATIO * int(counts[1:].max()) or chance < PILE_CHANCE
