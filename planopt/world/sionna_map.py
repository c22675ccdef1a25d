"""Radio maps of Sionna RT, saved from Python with ``numpy.savez``.

``savez(file, path_gain=map.path_gain.numpy(), cell_centers=map.cell_centers.numpy())`` keeps what
is needed. Gains are linear there, and zero means that no path was found.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from planopt.errors import InputError
from planopt.world.raster import Raster, checked_raster, npz_arrays

CENTRES = "cell_centers"

TURNED_M = 1e-2
"""How far, in metres, a centre may be off its row or column: Sionna computes in float32."""


def read_sionna_map(path: Path, variable: str) -> Raster:
    """Read a linear quantity of a planar radio map in dB.

    Parameters
    ----------
    path
        An npz with `variable` on ``(transmitter, iy, ix)`` or ``(iy, ix)`` and ``cell_centers`` on
        ``(iy, ix, 3)``.
    variable
        Its name, such as ``path_gain``; with several transmitters ``path_gain[2]`` is that of the
        third. NaN in the result where it is zero.

    Raises
    ------
    InputError
        The file holds no such variable, the transmitter is not there or not named, the plane is
        turned, or a value is negative.
    """
    name, index = _name_and_index(variable)
    gain, centres = npz_arrays(path, (name, CENTRES))
    if gain.ndim == 3:
        if index is None and len(gain) != 1:
            raise InputError(
                f"there are {len(gain)} transmitters", file=path, key=name, remedy=f"say {name}[0]"
            )
        if (index or 0) >= len(gain):
            raise InputError(
                f"there is no transmitter {index}, only {len(gain)}, counted from 0",
                file=path,
                key=name,
            )
        gain = gain[index or 0]
    if gain.ndim != 2 or centres.shape != (*gain.shape, 3):
        raise InputError(
            f"shapes {gain.shape} and {centres.shape} are not of a planar map", file=path, key=name
        )
    if not gain.size:
        raise InputError("the map has no cells", file=path, key=name)
    x, y = centres[0, :, 0], centres[:, 0, 1]
    with np.errstate(all="ignore"):  # centres that are not finite
        off = np.maximum(np.abs(centres[..., 0] - x), np.abs(centres[..., 1] - y[:, None]))
    # Written so that a centre that is NaN counts as off.
    if not (off <= TURNED_M).all():
        raise InputError(
            "the map's plane is turned: rows do not run along x", file=path, key=CENTRES
        )
    if (gain < 0.0).any():
        raise InputError("a linear gain is negative", file=path, key=name)
    decibels = np.full(gain.shape, np.nan)
    np.log10(gain, out=decibels, where=gain > 0.0)
    return checked_raster(x, y, 10.0 * decibels, path, variable)


def _name_and_index(variable: str) -> tuple[str, int | None]:
    """``path_gain[2]`` as its parts."""
    match = re.fullmatch(r"(.+)\[(\d{1,6})\]", variable)
    return (variable, None) if match is None else (match[1], int(match[2]))
