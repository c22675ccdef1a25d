"""Safe reading of input files and npz archives, which may be devices, pipes, huge or damaged.

NumPy's own reader would allocate any size declared in a header and unpack any zip archive.
"""

from __future__ import annotations

import contextlib
import csv
import io
import math
import os
import stat
import sys
import warnings
import zipfile
from collections.abc import Collection, Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planopt.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

MEGABYTE = 2**20

LARGEST_TEXT_BYTES = 64 * MEGABYTE
"""Size limit of text files (tables, obstacles, saved JSON). A log of a million rows has 30 MB."""
LARGEST_BINARY_BYTES = 512 * MEGABYTE
"""Size limit of binary files, and of all arrays unpacked from one npz file."""
LARGEST_ARRAY_VALUES = 25_000_000
"""Maximum number of values in one array of a file, such as a map of 5000 x 5000 cells."""
DATA_FOLDER = "PLANOPT_DATA"
"""Environment variable with the folder of measurements that planopt may not distribute."""
PRIVATE = f"${DATA_FOLDER}/"  # Beginning of the names of files in that folder


def data_folder() -> Path | None:
    """Return the folder that `DATA_FOLDER` names; None if it is not set or empty."""
    folder = os.environ.get(DATA_FOLDER)
    return Path(folder).absolute() if folder else None


def read_bytes(path: Path, largest: int = LARGEST_BINARY_BYTES) -> bytes:
    """Return the content of a regular file."""
    try:
        # The check precedes opening because opening a pipe blocks and a device may react.
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            kind = "a folder, not a file" if path.is_dir() else "not a regular file"
            raise InputError(f"is {kind}", file=path, remedy="give the path of an ordinary file")
        with path.open("rb") as stream:
            # Files in /proc report size 0 and have content nevertheless.
            content = b"" if status.st_size > largest else stream.read(largest + 1)
    except FileNotFoundError as error:
        raise InputError("does not exist", file=path, remedy="check the path") from error
    except (OSError, ValueError) as error:  # ValueError: NUL in the name
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot be read: {reason}", file=path, remedy="check the path") from error
    require_size("has", max(status.st_size, len(content)), largest, path)
    return content


def require_size(verb: str, size: int, largest: int, path: Path) -> None:
    """Raise an error for a file with too many bytes, actual or declared."""
    if size > largest:
        found, limit = f"{size:,} bytes", f"{largest:,} bytes"
        remedy = "give a smaller file: fewer rows or larger cells"
        raise InputError(
            f"{verb} {found}, more than the limit of {limit}", file=path, remedy=remedy
        )


def read_text(path: Path, largest: int = LARGEST_TEXT_BYTES) -> str:
    """Return the content of a regular UTF-8 text file without its byte order mark."""
    content = read_bytes(path, largest)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        fault = f"is not UTF-8 text: {error.reason} at byte {error.start}"
        raise InputError(
            fault, file=path, remedy="save it as UTF-8 text, in Excel as CSV UTF-8"
        ) from None
    if "\0" in text:
        fault = f"is not text: NUL at character {text.index(chr(0))}"
        raise InputError(fault, file=path, remedy="give a text file")
    return text


def csv_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of every non-empty row of a CSV file."""
    rows = csv.reader(io.StringIO(read_text(path), newline=None), strict=True)
    try:
        for cells in rows:
            if cells:
                yield rows.line_num, cells
    except csv.Error as error:
        fault, remedy = f"not a CSV row: {error}", "save it as CSV with commas"
        raise InputError(fault, file=path, row=rows.line_num, remedy=remedy) from error


@contextlib.contextmanager
def foreign_reader(path: Path, kind: str, key: str | None = None) -> Generator[None]:
    """Convert a reader library's exceptions to an error about the file; suppress warnings."""
    # Errors in destructors and callbacks, which Python would print, are suppressed as well.
    hooks = sys.excepthook, sys.unraisablehook
    sys.excepthook = sys.unraisablehook = _ignore
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InputError as error:
        found = InputError(error.message, key=error.key or key, row=error.row, remedy=error.remedy)
        raise found.located(error.file or path) from error
    except Exception as error:
        fault, remedy = f"is damaged, or is not {kind} that can be read", "copy or export it again"
        raise InputError(fault, file=path, key=key, remedy=remedy) from error
    finally:
        sys.excepthook, sys.unraisablehook = hooks


def _ignore(*_: object) -> None:
    """Accept any arguments and do nothing with them."""


def require_array_size(path: Path, key: str, *lengths: int) -> None:
    """Raise an error for an array that declares too many values, before it is read."""
    shape = " x ".join(str(int(length)) for length in lengths)
    if min(lengths, default=0) < 0:
        fault = f"declares the invalid shape {shape}"
        raise InputError(fault, file=path, key=key, remedy="export the file again")
    if math.prod(map(int, lengths)) > LARGEST_ARRAY_VALUES:
        fault = f"has {shape} values, more than the limit of {LARGEST_ARRAY_VALUES}"
        raise InputError(fault, file=path, key=key, remedy="give a smaller map")


MOST_ENTRIES = 10_000  # Maximum number of arrays in one file: each entry becomes an object


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
    """Return the zip archive of an npz file, and the archive's members by array name."""
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
    """Return one array of an archive after checking the size that its header declares."""
    # Listing the library reads texts only.
    import numpy as np
    from numpy.lib import format as npy

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
