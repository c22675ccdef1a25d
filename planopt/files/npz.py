"""Arrays of an npz file, read after a check of their declared sizes.

NumPy's own reader would allocate any size declared in a header and unpack any zip archive.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.reading import (
    LARGEST_BINARY_BYTES,
    foreign_reader,
    read_bytes,
    require_array_size,
    require_size,
)

MOST_ENTRIES = 10_000
"""Maximum number of arrays in one file: each entry becomes an object."""


def npz_names(path: Path) -> tuple[str, ...]:
    """Return the names of the arrays in an npz file."""
    return tuple(_members(path)[1])


def read_npz(path: Path, wanted: Collection[str] | None = None) -> dict[str, NDArray[Any]]:
    """Read arrays of an npz file; pickled objects are rejected."""
    archive, members = _members(path)
    names = [name for name in members if wanted is None or name in wanted]
    unpacked = sum(members[name].file_size for name in names)
    require_size("declares arrays of", unpacked, LARGEST_BINARY_BYTES, path)
    return {name: _array(path, archive, name, members[name]) for name in names}


def _members(path: Path) -> tuple[zipfile.ZipFile, dict[str, zipfile.ZipInfo]]:
    """Return the archive and its members by array name."""
    content = read_bytes(path)
    if not content.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        raise InputError("is not an npz archive", file=path)
    with foreign_reader(path, "an npz"):
        if content.count(b"PK\x01\x02") > MOST_ENTRIES:
            raise InputError(f"contains more than {MOST_ENTRIES} arrays")
        archive = zipfile.ZipFile(io.BytesIO(content))
        return archive, {each.filename.removesuffix(".npy"): each for each in archive.infolist()}


def _array(
    path: Path, archive: zipfile.ZipFile, name: str, member: zipfile.ZipInfo
) -> NDArray[Any]:
    """Return one array after checking the size declared in its header, which NumPy allocates."""
    with foreign_reader(path, "an npz", name), archive.open(member) as stream:
        first = npy.read_magic(stream) == (1, 0)
        read_header = npy.read_array_header_1_0 if first else npy.read_array_header_2_0
        shape, by_columns, dtype = read_header(stream)
        if dtype.hasobject:
            raise InputError("contains pickled Python objects, which are not loaded for security")
        require_array_size(path, name, *shape)
        content = stream.read(math.prod(shape) * dtype.itemsize)
        # The checksum is compared at the end of the stream.
        if stream.read(1):
            raise InputError("has a size that contradicts its header")
        flat = np.frombuffer(content, dtype=dtype)
        if dtype.kind == "U":
            # Code points that are not Unicode would make Python fail much later.
            codes = flat.view(np.dtype(np.uint32).newbyteorder(dtype.byteorder))
            if ((codes > 0x10FFFF) | ((codes >= 0xD800) & (codes <= 0xDFFF))).any():
                raise InputError("has texts with invalid characters")
        return flat.reshape(shape, order="F" if by_columns else "C").copy()
