"""Ground truth from a log alone: drawn from its posterior, or from a map fitted to it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import planopt
from planopt import InputError, Measurements, Problem
from planopt.channel import true_power_dbm
from planopt.cli import main
from planopt.planning.initial_data import prepare
from planopt.problems import (
    FittedTruth,
    LoggedMeasurements,
    RasterTruth,
    SampledMeasurements,
    problem_from_dict,
    problem_to_dict,
)

WORLD = planopt.load("open_field")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first measurements of the open field."""
    measured = prepare(WORLD, 0).belief.posterior.measurements
    rows = np.column_stack([measured.positions_m, measured.power_dbm])
    path = tmp_path_factory.mktemp("log") / "log.csv"
    np.savetxt(path, rows, delimiter=",", header="x_m,y_m,power_dbm", comments="")
    return path


def of_log(log: Path, truth: FittedTruth | RasterTruth | None) -> Problem:
    """The open field with a log in place of its channel."""
    channel = replace(WORLD.channel, measurements=LoggedMeasurements(log), truth=truth)
    return replace(WORLD, channel=channel, planner=replace(WORLD.planner, max_steps=3))


def test_a_log_suffices_for_a_simulation(log: Path) -> None:
    """The truth has the fitted path loss, agrees with the log to its noise, and saves and loads."""
    problem = of_log(log, FittedTruth(cell_m=0.5))
    assert problem_from_dict(problem_to_dict(problem)).channel.truth == problem.channel.truth
    prepared = prepare(problem, 0)
    known = prepared.belief.posterior.measurements
    off = true_power_dbm(prepared.truths[0], known.positions_m) - known.power_dbm
    multipath = prepared.belief.fit.parameters.multipath_std_db
    # The log and the truth have multipath of their own.
    assert off.std() == pytest.approx(np.sqrt(2.0) * multipath, rel=0.3)
    assert np.array_equal(
        prepared.truths[0].raster.values, prepare(problem, 0).truths[0].raster.values
    )
    assert not np.allclose(
        prepared.truths[0].raster.values, prepare(problem, 1).truths[0].raster.values
    )
    assert len(planopt.simulate(problem, horizon=2).runs[0].log.positions_m) == 4


def test_without_a_log_there_is_nothing_to_fit(log: Path) -> None:
    """Measurements cannot be taken from a truth that is fitted to them."""
    problem = of_log(log, FittedTruth(cell_m=1.0))
    tables = problem_to_dict(problem)
    tables["channel"]["measurements"] = {"count": 5}
    with pytest.raises(InputError, match=r"channel\.truth\.kind.*no log"):
        problem_from_dict(tables)
    given = Measurements([[10.0, 10.0], [50.0, 40.0], [90.0, 20.0]], [-50.0, -55.0, -62.0])
    bare = replace(problem, channel=replace(problem.channel, measurements=SampledMeasurements()))
    assert planopt.solve(bare, measurements=given, horizon=1).plan is not None


@pytest.mark.parametrize("ending", ["npz", "nc", "tif"])
def test_a_fitted_map_is_received_power(log: Path, ending: str, capsys) -> None:
    """As path gain it is refused with the remedy; as power it is the truth in dBm."""
    if ending == "tif":
        pytest.importorskip("rasterio")
    out = log.parent / f"map.{ending}"
    x, y = WORLD.stations[0].position_m
    command = ["map", str(log), "--station", f"{x},{y},{WORLD.stations[0].height_m}"]
    command += ["--bounds=0,0,120,100", "--cell", "5", "--out", str(out), "--json"]
    assert main(command) in (0, 3)
    assert json.loads(capsys.readouterr().out)["file"] == str(out)
    truth = RasterTruth(file=out, variable="mean_db", floor_db=-150.0)
    with pytest.raises(InputError, match=r"predicted received power in dBm.*quantity = .power"):
        prepare(of_log(log, truth), 0)
    with pytest.raises(InputError, match=r"standard deviation.*name a variable"):
        prepare(of_log(log, replace(truth, variable="deviation_db")), 0)
    power = prepare(of_log(log, replace(truth, quantity="power")), 0).truths[0]
    measured = prepare(WORLD, 0).belief.posterior.measurements
    off = true_power_dbm(power, measured.positions_m) - measured.power_dbm
    assert abs(off.mean()) < 1.0
