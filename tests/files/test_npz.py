"""Arrays of npz files: the same as NumPy's where they are sound, one error where they are not."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from planopt.files import reading
from planopt.files.reading import npz_names, read_npz

ARRAYS = {
    "positions": np.arange(6.0).reshape(3, 2),
    "by_columns": np.asfortranarray(np.arange(6.0).reshape(3, 2)),
    "flags": np.array([True, False]),
    "text": np.array("reml"),
    "texts": np.array(["a", "bcd"]),
    "big_endian": np.arange(3, dtype=">i4"),
    "none": np.zeros((0, 4)),
}


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def with_header(text: str, content: bytes = b"") -> bytes:
    header = text.encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + content


def archive(path: Path, members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as file:
        for name, content in members.items():
            file.writestr(f"{name}.npy", content)
    return path


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_sound_arrays_are_those_of_numpy(save, tmp_path: Path) -> None:
    """Values, shapes, dtypes and names; other arrays are left out."""
    path = tmp_path / "a.npz"
    save(path, **ARRAYS)
    assert npz_names(path) == tuple(ARRAYS)
    found = read_npz(path)
    with np.load(path) as arrays:
        for name in ARRAYS:
            np.testing.assert_array_equal(found[name], arrays[name])
            assert found[name].dtype == arrays[name].dtype
            assert found[name].flags.writeable
    assert list(read_npz(path, ("flags", "missing"))) == ["flags"]


@pytest.mark.parametrize(
    "content",
    [
        with_header("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000)}\n"),
        with_header("{'descr': '<f8', 'fortran_order': False, 'shape': (3, 2)}\n", b"12345"),
        npy(np.arange(3.0)) + b"more",
        with_header("{'descr': '<U99999999', 'fortran_order': False, 'shape': (1,)}\n"),
        with_header("{'descr': '<f8', 'fortran_order': False, 'shape': (-3,)}\n"),
        with_header("(" * 5000),
        with_header("'\\d'\n"),
        b"\x93NUMPY\x07\x00",
        b"",
        b"hello",
    ],
)
def test_members_that_are_no_sound_array(content: bytes, tmp_path: Path) -> None:
    """The array is named, and nothing is allocated for what a header declares."""
    path = archive(tmp_path / "a.npz", {"gain": content})
    with refused():
        read_npz(path)


def test_objects_are_never_unpickled(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, gain=np.array([{}], dtype=object))
    with refused():
        read_npz(path)


def test_a_zip_bomb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sum of the declared sizes of the requested arrays counts; the limit is exact."""
    path = tmp_path / "a.npz"
    np.savez_compressed(path, a=np.zeros(100_000), b=np.zeros(100_000), c=np.zeros(1))
    with zipfile.ZipFile(path) as file:
        sizes = {member.filename: member.file_size for member in file.infolist()}
    assert path.stat().st_size < sum(sizes.values()) / 100
    monkeypatch.setattr(reading, "LARGEST_BINARY_BYTES", sizes["a.npy"] + sizes["c.npy"])
    assert list(read_npz(path, ("a", "c"))) == ["a", "c"]
    with refused():
        read_npz(path)


def test_archives_that_are_damaged(tmp_path: Path) -> None:
    """Cut off, encrypted, of another version, or with too many members."""
    path = tmp_path / "a.npz"
    np.savez(path, gain=np.arange(9.0))
    whole = path.read_bytes()
    central = whole.index(b"PK\x01\x02")
    spoilt = {
        "encrypted": whole[: central + 8] + b"\x01" + whole[central + 9 :],
        "version": whole[: central + 6] + b"\xd9" + whole[central + 7 :],
        "cut": whole[:-30],
        "empty": b"",
        "text": b"x,y\n1,2\n",
        "checksum": whole[:150] + bytes([whole[150] ^ 255]) + whole[151:],
    }
    for content in spoilt.values():
        path.write_bytes(content)
        with refused():
            read_npz(path)
    path.write_bytes(b"PK\x03\x04" + 10_001 * b"PK\x01\x02")
    with refused():
        read_npz(path)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("code", [0x110000, 0xFFFFFFFF, 0xD800, 0xDFFF])
def test_texts_of_numbers_that_are_no_characters(code: int, order: str, tmp_path: Path) -> None:
    """NumPy hands them on, and Python fails with SystemError when the text is printed."""
    for last, sound in ((code, False), (0x10FFFF, True)):
        content = np.array([65, last], dtype=f"{order}u4").tobytes()
        header = with_header(f"{{'descr': '{order}U2', 'fortran_order': False, 'shape': ()}}\n")
        path = archive(tmp_path / "a.npz", {"fit_status": header + content})
        if sound:
            assert str(read_npz(path)["fit_status"]) == "A\U0010ffff"
            continue
        with refused():
            read_npz(path)
