"""NetCDF-3 headers and values, against SciPy's reader."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import netcdf_file

from planopt.errors import InputError
from planopt.world.netcdf_classic import classic_values, classic_variables


def written(path: Path, version: int = 1, records: int = 3, alone: bool = False) -> bytes:
    """A file with variables of every type, some of them with records, and attributes."""
    generator = np.random.default_rng(5)
    with netcdf_file(path, "w", version=version) as file:
        file.history = b"made for a test"
        file.createDimension("time", None)
        file.createDimension("y", 3)
        file.createDimension("x", 5)
        grid = file.createVariable("grid", "f", ("y", "x"))
        grid[:] = generator.normal(size=(3, 5))
        grid.scale_factor = 0.5
        grid.levels = np.array([1.0, 2.0])
        file.createVariable("scalar", "d", ()).data[...] = 7.5
        file.createVariable("odd", "b", ("x",))[:] = np.arange(5)
        kinds = {"one": "h"} if alone else {"one": "h", "two": "b", "three": "d", "four": "i"}
        for name, kind in kinds.items():
            variable = file.createVariable(name, kind, ("time", "x"))
            for record in range(records):
                variable[record] = generator.integers(0, 99, 5)
    return path.read_bytes()


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("records", [0, 1, 3])
@pytest.mark.parametrize("alone", [False, True])
def test_values_are_those_of_scipy(version: int, records: int, alone: bool, tmp_path) -> None:
    """Both versions; records of one variable lie close together, of several they are padded."""
    path = tmp_path / "a.nc"
    content = written(path, version, records, alone)
    found = classic_variables(content)
    with netcdf_file(path, "r", mmap=False) as file:
        assert set(found) == set(file.variables)
        for name, variable in file.variables.items():
            assert found[name].dimensions == variable.dimensions
            expected = variable.data
            if records or "time" not in variable.dimensions:
                np.testing.assert_array_equal(classic_values(content, found[name]), expected)
            else:
                assert found[name].shape == (0, 5)
        attributes = found["grid"].attributes
        assert float(attributes["scale_factor"][0]) == file.variables["grid"].scale_factor
        np.testing.assert_array_equal(attributes["levels"], [1.0, 2.0])


def test_a_file_that_was_never_closed(tmp_path: Path) -> None:
    """The number of records follows from the size of the file."""
    content = bytearray(written(tmp_path / "a.nc"))
    content[4:8] = b"\xff" * 4
    found = classic_variables(bytes(content))
    assert found["three"].shape == (3, 5)


@pytest.mark.parametrize("seed", range(3))
def test_damage_is_an_error_of_ours_or_other_values(seed: int, tmp_path: Path) -> None:
    """Whatever the bytes say, and wherever the file ends."""
    whole = written(tmp_path / "a.nc")
    generator = np.random.default_rng(seed)
    for _ in range(200):
        content = bytearray(whole[: generator.integers(1, len(whole) + 1)])
        for at in generator.integers(0, min(len(content), 500), 3):
            content[at] = generator.integers(256)
        try:
            for variable in classic_variables(bytes(content)).values():
                if np.prod(variable.shape, dtype=float) < 1e6:
                    classic_values(bytes(content), variable)
        except InputError as error:
            assert str(error).isprintable()


def test_a_name_that_is_no_text(tmp_path: Path) -> None:
    """Control characters of a damaged name never reach a message."""
    content = written(tmp_path / "a.nc")
    assert b"\0\0\0\x03two" in content
    for damaged in (b"t\0o", b"\x1b[m", b"\xff\xff\xff"):
        with pytest.raises(InputError, match=r"the name at byte \d+ is not text \(copy"):
            classic_variables(content.replace(b"\x03two", b"\x03" + damaged))
