"""What was known of the channel, from a file."""

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planopt import InputError, Measurements
from planopt.channel import Belief, Station, condition, fit_channel
from planopt.channel.posterior import update
from planopt.planning.files.belief_file import belief_arrays, read_belief


def drawn(count: int, seed: int) -> Measurements:
    """Measurements of which those below -75 dBm are only upper limits."""
    generator = np.random.default_rng(seed)
    positions = generator.uniform(0.0, 100.0, (count, 2))
    power = -40.0 - 0.4 * np.hypot(*positions.T) + generator.normal(0.0, 3.0, count)
    return Measurements(positions, np.maximum(power, -75.0), power <= -75.0)


@pytest.fixture
def beliefs() -> list[Belief]:
    """A belief from 40 measurements, then after 1 more, 1 more, and 1 more: one is censored."""
    first = drawn(40, 1)
    assert first.censored.any()
    fit = fit_channel(first, Station((-20.0, -10.0), 4.0))
    chain = [Belief(fit, condition(fit.parameters, first))]
    more = [
        Measurements(np.array([[50.0, 50.0]]), np.array([-66.0]), np.array([False])),
        Measurements(np.array([[95.0, 90.0]]), np.array([-75.0]), np.array([True])),
        Measurements(np.array([[70.0, 60.0]]), np.array([-70.0]), np.array([False])),
    ]
    for one in more:
        chain.append(update(chain[-1], one))
    return chain


@pytest.fixture
def file(tmp_path: Path, beliefs: list[Belief]) -> Path:
    """The last belief, of a run of four steps that measured after the first three."""
    path = tmp_path / "belief.npz"
    np.savez_compressed(path, **belief_arrays(beliefs[-1], np.array([40, 41, 42, 43])))
    return path


def test_every_measurement_of_a_run_comes_back(file: Path, beliefs: list[Belief]) -> None:
    """In the order taken, censored ones too, with what was known before each step."""
    saved = read_belief(file)
    assert saved.known_before_step.tolist() == [40, 41, 42, 43] and saved.first == 40
    for field in fields(Measurements):
        np.testing.assert_array_equal(
            getattr(saved.measurements, field.name),
            getattr(beliefs[-1].posterior.measurements, field.name),
        )
    assert saved.parameters == beliefs[0].fit.parameters


def test_ages_receivers_and_errors_come_back(tmp_path: Path) -> None:
    first = drawn(40, 2)
    first = replace(
        first,
        resolution_db=np.full(40, 0.5),
        position_std_m=np.linspace(0.0, 3.0, 40),
        time_s=np.linspace(0.0, 900.0, 40),
        receiver=np.arange(40) % 3,
    )
    fit = fit_channel(first, Station((-20.0, -10.0), 4.0), forgetting_s=600.0)
    belief = Belief(fit, condition(fit.parameters, first))
    path = tmp_path / "belief.npz"
    np.savez_compressed(path, **belief_arrays(belief, np.array([40])))
    saved = read_belief(path)
    for field in fields(Measurements):
        np.testing.assert_array_equal(
            getattr(saved.measurements, field.name), getattr(first, field.name)
        )
    assert saved.parameters == fit.parameters


def test_needs_no_pickle(file: Path) -> None:
    """The file opens with pickles forbidden and holds the standard errors in order."""
    with np.load(file, allow_pickle=False) as arrays:
        assert arrays["standard_errors"].shape == (5,)
        assert str(arrays["fit_method"]) == "map"


def rewritten(file: Path, **changes: Any) -> None:
    """Change arrays of the file; None removes one."""
    with np.load(file) as archive:
        arrays = dict(archive) | changes
    np.savez(file, **{name: array for name, array in arrays.items() if array is not None})


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("power_dbm", None),
        ("power_dbm", np.zeros((2, 2))),
        ("positions_m", np.zeros((3, 2))),
        ("positions_m", np.full((43, 2), np.nan)),
        ("censored", np.zeros(43)),
        ("parameters", np.array([1.0, 2.0, 3.0, -4.0, 5.0])),
        ("parameters", np.array([1.0, 2.0])),
        ("known_before_step", np.array([40, 39, 42, 43])),
        ("known_before_step", np.array([40, 41, 42, 99])),
        ("values_db", np.array(["a", "b"])),
        ("noise_variance_db2", np.full(43, 1e12)),
        ("noise_variance_db2", np.zeros(43)),
        ("forgetting_s", np.array(0.0)),
        ("resolution_db", np.full(43, -1.0)),
        ("time_s", np.full(43, np.nan)),
        ("position_std_m", np.full(43, -1.0)),
        ("resolution_db", np.zeros(42)),
        ("receiver", np.zeros(43)),
        ("forgetting_s", np.array(0.0)),
    ],
)
def test_a_damaged_array_is_named(file: Path, key: str, value: Any) -> None:
    """A missing, misshapen or impossible array is an error with the file and its name."""
    rewritten(file, **{key: value})
    with pytest.raises(InputError) as raised:
        read_belief(file)
    assert raised.value.key == key and raised.value.file == str(file)


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def flipped(file: Path) -> None:
    """Bytes in the middle of an array are others."""
    data = bytearray(file.read_bytes())
    data[200:260] = bytes(60)
    file.write_bytes(data)


def pickled(file: Path) -> None:
    """An array of objects, which only a pickle can hold."""
    np.savez(file, power_dbm=np.array([{}], dtype=object))


def plain_array(file: Path) -> None:
    with file.open("wb") as stream:
        np.save(stream, np.zeros(3))


@pytest.mark.parametrize(
    "damage", [cut, flipped, pickled, plain_array, Path.unlink, lambda file: file.write_bytes(b"")]
)
def test_a_damaged_file_is_an_error(file: Path, damage: Callable[[Path], object]) -> None:
    """A truncated, corrupt, empty, missing or pickled file is an error that names it."""
    damage(file)
    with pytest.raises(InputError) as raised:
        read_belief(file)
    assert raised.value.file == str(file)
