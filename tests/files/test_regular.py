"""Bounded reading: only regular files, of known size, as text that is text."""

import os
from pathlib import Path

import pytest
from refusals import refused

from planopt import InputError
from planopt.files.reading import foreign_reader, read_bytes, read_text, require_array_size

needs_devices = pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no devices")


def test_content_is_returned(tmp_path: Path) -> None:
    """Bytes as they are; text without its byte order mark; a symbolic link is followed."""
    path = tmp_path / "a"
    path.write_bytes(b"\xef\xbb\xbfab\r\n")
    (tmp_path / "link").symlink_to(path)
    assert read_bytes(path) == read_bytes(tmp_path / "link") == b"\xef\xbb\xbfab\r\n"
    assert read_text(path) == "ab\r\n"


@needs_devices
@pytest.mark.parametrize("name", ["/dev/zero", "link", "pipe", "."])
def test_what_is_no_regular_file(name: str, tmp_path: Path) -> None:
    """A device, a link to one, a pipe without a writer, a folder: refused without waiting."""
    (tmp_path / "link").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe")
    with refused():
        read_bytes(tmp_path / name)


def test_a_missing_file_and_a_name_that_cannot_be(tmp_path: Path) -> None:
    with refused():
        read_bytes(tmp_path / "none")
    for name in ("a\0b", "n" * 5000):
        with refused():
            read_bytes(tmp_path / name)


def test_size_limit(tmp_path: Path) -> None:
    """One byte more than the limit is refused, and a sparse file is not read at all."""
    path = tmp_path / "a"
    path.write_bytes(b"x" * 100)
    assert len(read_bytes(path, largest=100)) == 100
    with refused():
        read_bytes(path, largest=99)
    os.truncate(path, 2**40)
    with refused():
        read_bytes(path)


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="no /proc")
def test_a_file_that_says_it_is_empty_is_still_bounded() -> None:
    """Files of /proc have size 0 and any content."""
    assert Path("/proc/self/maps").stat().st_size == 0
    with refused():
        read_bytes(Path("/proc/self/maps"), largest=10)


@pytest.mark.parametrize("content", [b"a\xff", b"a\0b"])
def test_what_is_no_text(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(content)
    with refused():
        read_text(tmp_path / "a")


def test_array_sizes() -> None:
    """A product above the limit and a negative length are refused, whatever their type."""
    path = Path("map.nc")
    require_array_size(path, "gain", 5000, 5000)
    require_array_size(path, "gain")
    for lengths in ((10**6, 10**6), (-1, -1), (2**62, 4)):
        with refused():
            require_array_size(path, "gain", *lengths)


@pytest.mark.parametrize("error", [MemoryError(), RecursionError("deep"), EOFError(), KeyError(3)])
def test_foreign_errors_become_ours(error: Exception) -> None:
    """Whatever a dependency raises; interrupts and errors of ours pass."""
    with refused():
        with foreign_reader(Path("a.nc"), "a NetCDF file"):
            raise error
    with refused(), foreign_reader(Path("a.nc"), "a file"):
        raise InputError("ours")
    for passed in (InputError("ours", file="b.nc"), KeyboardInterrupt()):
        with pytest.raises(type(passed)) as caught, foreign_reader(Path("a.nc"), "a file"):
            raise passed
        assert str(caught.value) == str(passed)
