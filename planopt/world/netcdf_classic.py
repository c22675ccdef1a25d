"""The header of NetCDF-3 files and the values of single variables, from the file's bytes.

SciPy's reader reads every variable, as large as the header declares it, and lets attributes of the
file replace its own. This one reads what is asked for and checks what the header says against the
size of the file. The format is that of the NetCDF Users Guide, "File Format Specifications".
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.regular import AGAIN

SIGNATURES = {b"CDF\x01": ">I", b"CDF\x02": ">Q"}
"""First bytes by the kind of offsets that follow: of 32 or of 64 bits."""

TYPES = {1: "i1", 2: "S1", 3: ">i2", 4: ">i4", 5: ">f4", 6: ">f8"}

DIMENSIONS, VARIABLES, ATTRIBUTES = 10, 11, 12
STREAMING = 2**32 - 1
"""Number of records of a file that was never closed."""


@dataclass(frozen=True)
class ClassicVariable:
    """The place of a variable in a file."""

    dimensions: tuple[str, ...]  # Names and lengths
    shape: tuple[int, ...]
    attributes: Mapping[str, NDArray[Any] | bytes]  # Numbers as arrays, text as bytes
    dtype: np.dtype[Any]  # Of its values in the file
    begin: int  # Offset of its first value, in bytes
    # Distance between its records; None if its first dimension is not the record dimension
    record_bytes: int | None


def classic_variables(content: bytes) -> dict[str, ClassicVariable]:
    """Return the variables of a NetCDF-3 file by name."""
    offsets = SIGNATURES.get(content[:4])
    if offsets is None:
        raise InputError("neither NetCDF-3 nor NetCDF-4")
    header = _Header(content, 4)
    records = header.count(largest=STREAMING)
    dimensions = [(header.name(), header.count()) for _ in header.items(DIMENSIONS)]
    header.attributes()
    described = [_described(header, dimensions, offsets) for _ in header.items(VARIABLES)]
    in_records = [one for one in described if one.is_record]
    record_bytes = sum(one.padded_bytes for one in in_records)
    if len(in_records) == 1:
        # A lone record variable is not padded.
        record_bytes = in_records[0].record_values * in_records[0].dtype.itemsize
    if records == STREAMING:
        left = len(content) - min((one.begin for one in in_records), default=len(content))
        records = left // record_bytes if record_bytes else 0
    return {
        one.name: ClassicVariable(
            one.dimensions,
            (records, *one.lengths[1:]) if one.is_record else one.lengths,
            one.attributes,
            one.dtype,
            one.begin,
            record_bytes if one.is_record else None,
        )
        for one in described
    }


def classic_values(content: bytes, variable: ClassicVariable) -> NDArray[Any]:
    """Return the values of a variable."""
    item = variable.dtype.itemsize
    rows = variable.shape[0] if variable.shape else 1
    row_bytes = math.prod(variable.shape[1:]) * item
    stride = row_bytes if variable.record_bytes is None else variable.record_bytes
    if rows == 0 or row_bytes == 0:
        return np.zeros(variable.shape, dtype=variable.dtype)
    end = variable.begin + (rows - 1) * stride + row_bytes
    if end > len(content):
        raise InputError(f"the file ends before its values: {len(content)} of {end} bytes")
    # Rows are `stride` apart, values within a row close together.
    inner = np.array(variable.shape[1:], dtype=np.int64)
    strides = [item * int(np.prod(inner[axis + 1 :])) for axis in range(len(inner))]
    return np.ndarray(
        variable.shape,
        dtype=variable.dtype,
        buffer=content,
        offset=variable.begin,
        strides=(stride, *strides) if variable.shape else (),
    ).copy()


@dataclass(frozen=True)
class _Described:
    """A variable as the header has it; the length of the record dimension is 0."""

    name: str
    dimensions: tuple[str, ...]
    lengths: tuple[int, ...]
    attributes: Mapping[str, NDArray[Any] | bytes]
    dtype: np.dtype[Any]
    begin: int

    @property
    def is_record(self) -> bool:
        return bool(self.lengths) and self.lengths[0] == 0

    @property
    def record_values(self) -> int:
        return math.prod(self.lengths[1:])

    @property
    def padded_bytes(self) -> int:
        """Return the bytes of a record, padded to a multiple of four."""
        return -(-self.record_values * self.dtype.itemsize // 4) * 4


def _described(header: _Header, dimensions: list[tuple[str, int]], offsets: str) -> _Described:
    name = header.name()
    own: list[tuple[str, int]] = []
    for _ in range(header.count(largest=len(dimensions))):
        number = header.count(largest=len(dimensions) - 1)
        own.append(dimensions[number])
    attributes = header.attributes()
    dtype = header.dtype()
    header.take(">I")  # The size, which follows from shape and type.
    begin = header.take(offsets)
    lengths = tuple(length for _, length in own)
    if 0 in lengths[1:]:
        raise InputError(f"the record dimension is not the first of {name}")
    return _Described(name, tuple(name for name, _ in own), lengths, attributes, dtype, begin)


@dataclass
class _Header:
    """A header while it is read: its bytes and the place reached."""

    content: bytes
    at: int

    def take(self, form: str) -> int:
        """The next number."""
        (number,) = struct.unpack(form, self.bytes(struct.calcsize(form)))
        return int(number)

    def bytes(self, count: int) -> bytes:
        """The next `count` bytes."""
        found = self.content[self.at : self.at + count]
        if len(found) < count:
            raise InputError("the file ends within its header")
        self.at += count
        return found

    def padded(self, count: int) -> bytes:
        """The next `count` bytes, and what fills them up to a multiple of four."""
        found = self.bytes(count)
        self.bytes(-count % 4)
        return found

    def count(self, largest: int = 2**31 - 1) -> int:
        """The next number, at most `largest`."""
        number = self.take(">I")
        if number > largest:
            raise InputError(f"{number} at byte {self.at - 4} is too large")
        return number

    def name(self) -> str:
        """The next name."""
        start, count = self.at, self.count(largest=len(self.content))
        try:
            text = self.padded(count).decode("utf-8")
        except UnicodeDecodeError:
            text = ""
        if not text or not text.isprintable():
            raise InputError(f"the name at byte {start} is not text", remedy=AGAIN)
        return text

    def items(self, tag: int) -> range:
        """A range over the entries of the list that follows, which is tagged unless empty."""
        found, count = self.take(">I"), self.count(largest=len(self.content))
        if found != tag and (found, count) != (0, 0):
            raise InputError(f"a list of kind {found} at byte {self.at - 8}, not {tag}")
        return range(count)

    def dtype(self) -> np.dtype[Any]:
        """The next type."""
        code = self.take(">I")
        if code not in TYPES:
            raise InputError(f"type {code} at byte {self.at - 4} is not known")
        return np.dtype(TYPES[code])

    def attributes(self) -> dict[str, NDArray[Any] | bytes]:
        """The list of attributes that follows."""
        found: dict[str, NDArray[Any] | bytes] = {}
        for _ in self.items(ATTRIBUTES):
            name, dtype = self.name(), self.dtype()
            content = self.padded(self.count(largest=len(self.content)) * dtype.itemsize)
            found[name] = content if dtype.kind == "S" else np.frombuffer(content, dtype=dtype)
        return found
