"""Arrays from an ``npz`` file that may be damaged: each asked for by name, type and shape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.npz import read_npz
from planopt.planning.files.record import LARGEST, REMEDY


@dataclass(frozen=True)
class NpzArrays:
    """The arrays of a file, asked for by name; `prefix` is what stands before it in the file."""

    path: Path
    arrays: Mapping[str, NDArray[Any]]
    prefix: str = ""

    def within(self, prefix: str) -> NpzArrays:
        """Those whose names begin with `prefix`, asked for without it."""
        own = {
            name.removeprefix(prefix): array
            for name, array in self.arrays.items()
            if name.startswith(prefix)
        }
        return NpzArrays(self.path, own, prefix)

    def without(self, prefix: str) -> NpzArrays:
        """The others."""
        rest = {n: array for n, array in self.arrays.items() if not n.startswith(prefix)}
        return NpzArrays(self.path, rest, self.prefix)

    def error(self, name: str, message: str) -> InputError:
        """What to raise if the array `name` cannot be used."""
        return InputError(message, file=self.path, key=self.prefix + name, remedy=REMEDY)

    def of_kind(self, name: str, kinds: str, shape: tuple[int, ...] | None) -> NDArray[Any]:
        """An array of one of the dtype `kinds` and of `shape`, None for any one dimension."""
        if name not in self.arrays:
            raise self.error(name, "the array is missing")
        array = self.arrays[name]
        fits = array.ndim == 1 if shape is None else array.shape == shape
        if not fits or array.dtype.kind not in kinds:
            raise self.error(
                name, f"an array of shape {array.shape} and type {array.dtype} does not fit"
            )
        return array

    def floats(
        self, name: str, shape: tuple[int, ...] | None, largest: float = LARGEST
    ) -> NDArray[np.float64]:
        """Finite numbers of magnitude at most `largest`."""
        array = self.of_kind(name, "f", shape).astype(np.float64)
        if not (np.isfinite(array) & (np.abs(array) <= largest)).all():
            raise self.error(name, "a number is not finite or too large")
        return array


def saved_arrays(path: Path) -> NpzArrays:
    """Read every array of a file.

    Raises
    ------
    InputError
        As :func:`planopt.files.npz.read_npz`.
    """
    return NpzArrays(path, read_npz(path))
