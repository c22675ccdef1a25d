"""Measurements: validation, selection, joining; tables and lists give the same answers."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

import planopt
from planopt.channel import Measurements, fit_channel
from planopt.channel.measurements import as_measurements, join

OPTIONAL = ("resolution_db", "position_std_m", "time_s", "receiver")


def some(count, start=0.0):
    values = start + np.arange(count, dtype=float)
    return Measurements(np.column_stack([values, values]), values, values % 2 == 1)


def all_given(count, start=0.0):
    """Measurements with every field given, each value another."""
    values = start + np.arange(count, dtype=float)
    return Measurements(
        np.column_stack([values, values]),
        values,
        values % 2 == 1,
        resolution_db=values + 1.0,
        position_std_m=values + 2.0,
        time_s=values + 3.0,
        receiver=np.arange(count) + 4,
    )


def test_lists_and_missing_columns():
    """Pairs and powers in lists are arrays; columns that are left out are zero."""
    plain = some(3)
    for name in OPTIONAL:
        np.testing.assert_array_equal(getattr(plain, name), np.zeros(3))
    assert plain.receiver.dtype == np.intp
    lists = planopt.Measurements(PLACES.tolist(), POWER.tolist())  # pyright: ignore
    assert same(lists, planopt.Measurements(PLACES, POWER, np.zeros(40, dtype=bool)))
    whole = planopt.Measurements([[0, 1], [2, 3]], [-50, -60])  # pyright: ignore
    assert whole.positions_m.dtype == whole.power_dbm.dtype == np.float64


@pytest.mark.parametrize(
    ("rows", "kept"),
    [
        (np.array([2, 0]), [2, 0]),
        (np.array([False, True, True, False]), [1, 2]),
        (slice(1, None), [1, 2, 3]),
        (slice(0, 0), []),
    ],
)
def test_take_takes_every_field(rows, kept):
    """By indices in their order, by a mask and by a slice."""
    whole = all_given(4)
    part = whole.take(rows)
    for field in fields(Measurements):
        np.testing.assert_array_equal(getattr(part, field.name), getattr(whole, field.name)[kept])


def test_join_joins_every_field():
    """Given ones after ones that were left out, and empty sets."""
    first, second = some(2), all_given(3)
    joined = join(first, second)
    for field in fields(Measurements):
        np.testing.assert_array_equal(
            getattr(joined, field.name),
            np.concatenate([getattr(first, field.name), getattr(second, field.name)]),
        )
    assert len(join(some(0), second)) == 3


STATION = planopt.channel.Station((0.0, 0.0), height_m=5.0)
GENERATOR = np.random.default_rng(3)
PLACES = GENERATOR.uniform(10.0, 90.0, (40, 2))
POWER = -40.0 - 25.0 * np.log10(np.hypot(*PLACES.T)) + GENERATOR.normal(0.0, 4.0, 40)
CENSORED = POWER < np.quantile(POWER, 0.1)
ARRAYS = planopt.Measurements(PLACES, POWER, CENSORED)
COLUMNS = {
    "x_m": PLACES[:, 0].tolist(),
    "y_m": PLACES[:, 1].tolist(),
    "power_dbm": POWER.tolist(),
    "censored": CENSORED.astype(int).tolist(),
    "comment": ["nothing"] * 40,
}


def frame(columns: dict[str, Any]) -> Any:
    pandas = pytest.importorskip("pandas")
    return pandas.DataFrame(columns)


TABLES: dict[str, Callable[[dict[str, Any]], Any]] = {"dictionary": dict, "DataFrame": frame}


def same(one: planopt.Measurements, other: planopt.Measurements) -> bool:
    return all(
        np.array_equal(value, getattr(other, name)) and value.dtype == getattr(other, name).dtype
        for name, value in vars(one).items()
    )


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_table_is_measurements(table: Callable[[dict[str, Any]], Any]) -> None:
    """Columns are found by name, whatever else there is; measurements are left alone."""
    assert same(as_measurements(table(COLUMNS)), ARRAYS)
    assert as_measurements(ARRAYS) is ARRAYS
    more = {**COLUMNS, "time_s": list(range(40)), "receiver": [0, 1] * 20}
    found = as_measurements(table(more))
    assert found.time_s[-1] == 39.0 and found.receiver.dtype == np.intp and found.receiver[1] == 1


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_public_calls_take_tables(table: Callable[[dict[str, Any]], Any]) -> None:
    given = table(COLUMNS)
    fit = fit_channel(given, STATION)
    assert fit.parameters == fit_channel(ARRAYS, STATION).parameters
    parameters = fit.parameters
    places = PLACES[:3] + 1.0

    def mean(of: Any) -> Any:
        return of.predict(places).mean_db.tolist()

    one = planopt.channel.condition(parameters, given)
    assert mean(one) == mean(planopt.channel.condition(parameters, ARRAYS))
    few = planopt.channel.condition(parameters, ARRAYS.take(slice(20)))
    part = table({name: values[20:] for name, values in COLUMNS.items()})
    assert mean(few.extend(part)) == mean(few.extend(ARRAYS.take(slice(20, None))))
    marginal = planopt.channel.marginalise(parameters, given)
    assert mean(marginal) == mean(planopt.channel.marginalise(parameters, ARRAYS))
    found = planopt.channel.fit_channel_and_station(given, station_method="line")
    again = planopt.channel.fit_channel_and_station(ARRAYS, station_method="line")
    assert found.parameters == again.parameters
    quarters = np.arange(40) // 10
    predictors = planopt.channel.predictors_of(lambda some: fit_channel(some, STATION))
    report = planopt.channel.held_out_report(given, quarters, quarters, predictors)
    assert report.measurements == 40 and report.censored == CENSORED.sum()


def test_public_calls_take_lists_of_places() -> None:
    """Places are lists of pairs, or two columns of a frame, as well as arrays."""
    posterior = planopt.channel.condition(fit_channel(ARRAYS, STATION).parameters, ARRAYS)
    path = np.column_stack([np.linspace(10.0, 80.0, 6), np.linspace(20.0, 60.0, 6)])
    lists, times = path.tolist(), list(range(6))
    level = -80.0

    def generator() -> np.random.Generator:
        return np.random.default_rng(1)

    traffic = planopt.channel.Traffic(link_bps=1e6, source_bps=1e5, buffer_bits=1e6)
    calls: list[Callable[[Any, Any], Any]] = [
        lambda p, t: posterior.predict(p).mean_db,
        lambda p, t: posterior.connectivity(p, level),
        lambda p, t: planopt.channel.joint_prediction(posterior, p).covariance_db2,
        lambda p, t: planopt.channel.sample_power(posterior, p, 3, generator()),
        lambda p, t: planopt.channel.first_passage(posterior, p, level, generator()).not_connected,
        lambda p, t: (
            planopt.channel.longest_outage(posterior, p, t, level, 9, generator()).metres.draws
        ),
        lambda p, t: (
            planopt.channel.delivered_data(
                posterior, p, t, level, traffic, deadline_s=5.0, count=9, generator=generator()
            ).delivered_bits.draws
        ),
        lambda p, t: planopt.channel.connected_to_any([posterior], p, level),
    ]
    forms = [(lists, times), (tuple(map(tuple, lists)), tuple(times))]
    columns = frame({"x_m": path[:, 0], "y_m": path[:, 1], "t_s": times})
    forms.append((columns[["x_m", "y_m"]], columns["t_s"]))
    for call in calls:
        wanted = call(path, np.arange(6.0))
        for places, when in forms:
            found = call(places, when)
            if isinstance(wanted, np.ndarray):
                np.testing.assert_array_equal(found, wanted)
