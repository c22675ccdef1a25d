"""Arrays of an npz file that may be damaged or hostile: sizes are checked before they are believed.

NumPy's own reader allocates what a header declares and unpacks whatever a zip archive holds.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Callable, Collection
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.regular import foreign_reader, read_bytes, require_array_size

LARGEST_UNPACKED_BYTES = 512 * 2**20
"""Size limit of all arrays read from one file: a zip archive unpacks to a thousandfold."""

LARGEST_ITEM_BYTES = 4096
"""Size limit of one value: texts are stored at the length of the longest."""

LARGEST_CHARACTER = 0x10FFFF
"""Of Unicode. Surrogates, which stand for halves of characters, are none either."""

SIGNATURES = (b"PK\x03\x04", b"PK\x05\x06")
"""First bytes of a zip archive, and of an empty one."""

METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Compression methods that NumPy writes."""

MOST_ENTRIES = 10_000
"""Limit of the number of arrays in one file."""

_ENDING = ".npy"
_ENTRY = b"PK\x01\x02"


def npz_names(path: Path) -> tuple[str, ...]:
    """Return the names of the arrays in an npz file."""
    return tuple(_members(path, _archive(path)))


def read_npz(path: Path, wanted: Collection[str] | None = None) -> dict[str, NDArray[Any]]:
    """Read arrays of an npz file; pickled objects are refused."""
    archive = _archive(path)
    members = {
        name: member
        for name, member in _members(path, archive).items()
        if wanted is None or name in wanted
    }
    unpacked = sum(member.file_size for member in members.values())
    if unpacked > LARGEST_UNPACKED_BYTES:
        raise InputError(
            f"declares {unpacked / 2**20:.0f} MB of arrays, more than the limit of "
            f"{LARGEST_UNPACKED_BYTES / 2**20:.0f} MB",
            file=path,
        )
    return {name: _array(path, archive, name, member) for name, member in members.items()}


def _archive(path: Path) -> zipfile.ZipFile:
    content = read_bytes(path)
    if not content.startswith(SIGNATURES):
        raise InputError("is not an npz archive", file=path)
    # Each entry of the archive's directory becomes an object of half a kilobyte.
    if content.count(_ENTRY) > MOST_ENTRIES:
        raise InputError(f"holds more than {MOST_ENTRIES} arrays", file=path)
    with foreign_reader(path, "an npz"):
        return zipfile.ZipFile(io.BytesIO(content))


def _members(path: Path, archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """The arrays by name."""
    members: dict[str, zipfile.ZipInfo] = {}
    for member in archive.infolist():
        name = member.filename.removesuffix(_ENDING)
        if name in members:
            raise InputError("stands in the archive twice", file=path, key=name)
        members[name] = member
    return members


def _array(
    path: Path, archive: zipfile.ZipFile, name: str, member: zipfile.ZipInfo
) -> NDArray[Any]:
    """One array, its declared size compared with that of its member first."""
    if member.compress_type not in METHODS or member.flag_bits & 0x1:
        raise InputError("is packed in a way that NumPy does not use", file=path, key=name)
    try:
        with foreign_reader(path, "an npz"), archive.open(member) as stream:
            shape, by_columns, dtype = _header(stream)
            if dtype.hasobject:
                raise InputError(
                    "holds Python objects, which are never unpickled", file=path, key=name
                )
            require_array_size(path, name, *shape)
            if not 0 < dtype.itemsize <= LARGEST_ITEM_BYTES:
                raise InputError(f"has values of {dtype.itemsize} bytes", file=path, key=name)
            count = math.prod(shape)
            content = stream.read(count * dtype.itemsize)
            # Reads what is left, if anything, for the checksum.
            if len(content) < count * dtype.itemsize or stream.read(1):
                raise InputError("has another size than its header says", file=path, key=name)
            flat = np.frombuffer(content, dtype=dtype, count=count)
            if dtype.kind == "U":
                _require_characters(path, name, flat)
            return flat.reshape(shape, order="F" if by_columns else "C").copy()
    except InputError as error:
        if error.key is not None:
            raise
        raise InputError(error.message, file=path, key=name, remedy=error.remedy) from error


def _require_characters(path: Path, name: str, texts: NDArray[np.str_]) -> None:
    """Refuse numbers that are no characters: Python fails on such a text much later."""
    codes = texts.view(np.dtype(np.uint32).newbyteorder(texts.dtype.byteorder))
    if ((codes > LARGEST_CHARACTER) | ((codes >= 0xD800) & (codes <= 0xDFFF))).any():
        raise InputError("has texts with characters that are none", file=path, key=name)


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether columns come first, and dtype, from the header of an npy file."""
    readers: dict[tuple[int, int], Callable[[IO[bytes]], Any]] = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    version = np.lib.format.read_magic(stream)
    if version not in readers:
        raise InputError(f"npy version {version[0]}.{version[1]} is not known")
    return readers[version](stream)
