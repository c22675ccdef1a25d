"""Several stations in problem files: keys, what is refused, saving."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

from planopt import Problem
from planopt.extend import casadi_term
from planopt.planning.initial_data import draw_initial_data
from planopt.problems.channel_setup import LoggedMeasurements, log_of
from planopt.problems.library import find_problem, read_toml
from planopt.problems.problem import problem_from_tables

Change = Callable[[dict[str, Any]], None]


def changed(change: Change, folder: Path = Path()) -> Problem:
    """The library's problem of two stations, changed."""
    tables = read_toml(find_problem("two_station_courier"))
    change(tables)
    return problem_from_tables(tables, folder=folder, file=None)


def logged(tables: dict[str, Any]) -> None:
    tables["channel"]["measurements"] = {"file": "log.csv", "censored_column": "weak"}
    tables["stations"][1]["power_column"] = "east_dbm"


def raster(tables: dict[str, Any]) -> None:
    tables["channel"]["truth"] = {
        "kind": "raster",
        "file": "gains.npz",
        "variable": "west_db",
        "floor_db": -140.0,
    }
    tables["stations"][1]["gain_variable"] = "east_db"


def both(*changes: Change) -> Change:
    def change(tables: dict[str, Any]) -> None:
        for each in changes:
            each(tables)

    return change


def set_in(*keys: Any) -> Change:
    *where, last, value = keys

    def change(tables: dict[str, Any]) -> None:
        found: Any = tables
        for key in where:
            found = found[key]
        found[last] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        set_in("stations", 1, "name", "west"),
        set_in("stations", 1, "gain_file", "a.npz"),
        set_in("stations", 0, "gain_variable", "a"),
        set_in("stations", 0, "log_file", "a.csv"),
        set_in("stations", 1, "power_column", "a"),
        set_in("stations", 1, "censored_column", "a"),
        both(raster, set_in("stations", 1, "gain_variable", "west_db")),
        both(logged, lambda tables: tables["stations"][1].pop("power_column")),
        set_in("stations", 1, "threshold_dbm", -1e9),
        both(
            set_in("constraints", "connectivity", "joint"), set_in("constraints", "p_min", 0.9999)
        ),
        set_in("constraints", "parameter_uncertainty", "all"),
    ],
)
def test_what_does_not_go_is_refused_with_its_key(change: Change) -> None:
    """When the problem is loaded, with what to do."""
    with refused() as caught:
        changed(change)
    assert caught.value.remedy or caught.value.message


@pytest.mark.parametrize("channel", [{}, {"channel": {}}, {"channel": {"measurements": {}}}])
def test_logs_of_stations_need_no_common_log(channel: dict[str, Any]) -> None:
    """Each station reads its own, without a table that repeats the first."""

    def change(tables: dict[str, Any]) -> None:
        del tables["channel"]
        tables |= channel
        for name, station in zip(("west.csv", "east.csv"), tables["stations"], strict=True):
            station["log_file"] = name

    problem = changed(change)
    log = problem.channel.measurements
    assert isinstance(log, LoggedMeasurements)
    files = [log_of(log, station).file.name for station in problem.stations]
    assert files == ["west.csv", "east.csv"]


@pytest.mark.parametrize(
    ("task", "term"),
    [
        (
            "map",
            {
                "kind": "mapping",
                "form": "two_layer",
                "variance_threshold_db2": 1.0,
                "closeness_per_m": 0.1,
            },
        ),
        ("custom", {"kind": "casadi", "steps": 3, "program": "mean"}),
    ],
)
def test_terms_of_one_power_are_refused(task: str, term: dict[str, Any]) -> None:
    if term["kind"] == "casadi":
        own = casadi_term(lambda path: path.mean_db[0], 3)
        term = {"kind": "casadi", "steps": own.steps, "program": own.program}

    def change(tables: dict[str, Any]) -> None:
        tables["problem"]["task"] = task
        tables["objective"] = {"terms": [term]}
        del tables["robots"][0]["goal_m"], tables["constraints"]["goal_radius_m"]

    with refused() as caught:
        changed(change)
    assert caught.value.remedy is not None
    assert caught.value.remedy.endswith("keep only one entry of stations")


def test_logs_are_read_by_station(tmp_path: Path) -> None:
    """A common log by column, without the flags of the other; or a log of its own."""
    lines = ["x_m,y_m,power_dbm,east_dbm,weak"]
    for k in range(12):
        lines.append(f"{10 * k},{5 + k % 3},{-50 - k},{-70 + k},{int(k == 4)}")
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    given = draw_initial_data(changed(logged, tmp_path), 0)
    west, east = given.measurements
    assert west.power_dbm == pytest.approx(-50.0 - np.arange(12))
    assert east.power_dbm == pytest.approx(-70.0 + np.arange(12))
    assert west.censored.sum() == 1
    assert not east.censored.any()
    (tmp_path / "east.csv").write_text(
        "\n".join(["x_m,y_m,power_dbm,weak", *(f"{9 * k},{k % 4},{-60 - k},0" for k in range(10))])
    )
    own = changed(both(logged, set_in("stations", 1, {"log_file": "east.csv"} | EAST)), tmp_path)
    other = draw_initial_data(own, 0).measurements[1]
    assert other.power_dbm == pytest.approx(-60.0 - np.arange(10))


EAST = {
    "name": "east",
    "position_m": [160.0, 70.0],
    "transmit_power_dbm": 23.0,
    "threshold_dbm": -59.0,
}


def test_maps_are_read_by_station(tmp_path: Path) -> None:
    x, y = np.arange(0.5, 180.0), np.arange(0.5, 80.0)
    shape = (len(y), len(x))
    np.savez(
        tmp_path / "gains.npz", x=x, y=y, west_db=np.full(shape, -90.0), east_db=np.full(shape, -80)
    )
    given = draw_initial_data(changed(raster, tmp_path), 0)
    assert [truth.raster.values[0, 0] for truth in given.truths] == [-70.0, -57.0]
    with refused():
        _load_with(tmp_path, both(raster, set_in("stations", 1, "gain_file", "none.npz")))
    places = [
        set_in("channel", part, "origin_deg", [latitude, 11.5])
        for part, latitude in (("truth", 48.1), ("measurements", 48.2))
    ]
    with refused():
        changed(both(raster, logged, *places), tmp_path)


def _load_with(folder: Path, change: Change) -> Problem:
    """As :func:`changed`, with the files looked for."""
    from planopt.problems.load import check_files

    problem = changed(change, folder)
    check_files(problem)
    return problem
