"""Ground truth, measured places and first beliefs of a seed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from scenes import RING, small_problem

import planopt
from planopt import InputError, Measurements, Problem, load
from planopt.channel import Nakagami, true_power_dbm
from planopt.cli import main
from planopt.planning.free_space import free_places
from planopt.planning.initial_data import draw_truth, prepare
from planopt.problems import (
    FittedTruth,
    LoggedMeasurements,
    RasterTruth,
    SampledMeasurements,
    problem_from_dict,
    problem_to_dict,
)
from planopt.world import Raster, write_rasters


@pytest.fixture(scope="module")
def problem():
    return load("open_field")


@pytest.fixture(scope="module")
def prepared(problem):
    return prepare(problem, 4)


def test_measurements_are_the_truth_at_free_places(problem, prepared):
    """As many as asked for, within bounds, outside obstacles, with the true power."""
    measured = prepared.belief.posterior.measurements
    assert len(measured) == 120
    points = shapely.points(measured.positions_m)
    for obstacle in problem.workspace.obstacles:
        assert not shapely.intersects(obstacle.polygon, points).any()
    assert ((measured.positions_m >= 0.0) & (measured.positions_m <= (120.0, 100.0))).all()
    assert (measured.power_dbm == true_power_dbm(prepared.truths[0], measured.positions_m)).all()
    assert prepared.belief.fit.measurements == 120
    assert prepared.belief.posterior.parameters == prepared.belief.fit.parameters


def test_levels_of_the_drawn_truth(problem):
    """Transmit power shifts it, and what is below a receiver's floor is censored there."""
    radio = problem.stations[0]
    louder = replace(
        problem, stations=(replace(radio, transmit_power_dbm=radio.transmit_power_dbm + 10.0),)
    )
    one, two = (draw_truth(p, np.random.default_rng(1)) for p in (problem, louder))
    assert np.allclose(two.raster.values - one.raster.values, 10.0)
    truth = replace(problem.channel.truth, floor_db=-80.0)
    found = prepare(replace(problem, channel=replace(problem.channel, truth=truth)), 4)
    measured = found.belief.posterior.measurements
    assert found.truths[0].floor_dbm == -60.0
    assert 0 < measured.censored.sum() < len(measured)
    assert (measured.power_dbm[measured.censored] == -60.0).all()
    assert (measured.power_dbm[~measured.censored] > -60.0).all()


def test_raster_truth(problem, tmp_path):
    """A map of gains, sent with the station's power; a place without any is at the floor."""
    x, y = np.arange(0.5, 120.0), np.arange(0.5, 100.0)
    gain = -90.0 + 0.1 * x[None] + 0.0 * y[:, None]
    gain[0, 0] = np.nan
    path = tmp_path / "map.npz"
    np.savez(path, gain=gain, x=x, y=y)
    truth = draw_truth(
        replace(
            problem,
            channel=replace(
                problem.channel, truth=RasterTruth(file=path, variable="gain", floor_db=-120.0)
            ),
        ),
        np.random.default_rng(0),
    )
    places = np.array([(0.4, 0.4), (50.5, 20.5)])
    assert np.allclose(true_power_dbm(truth, places), [-100.0, -90.0 + 5.05 + 20.0])


@pytest.mark.parametrize("ending", ["csv", "nc"])
def test_raster_truth_of_another_format(problem, tmp_path, ending):
    """The same map from CSV and NetCDF; the fading is of the law asked for."""
    x, y = np.arange(0.5, 120.0), np.arange(0.5, 100.0)
    gain = Raster(x, y, -90.0 + 0.1 * x[None] + 0.0 * y[:, None])
    path = tmp_path / f"map.{ending}"
    write_rasters(path, {"gain": gain})
    values = []
    for law in (None, Nakagami(2.0)):
        setup = RasterTruth(file=path, variable="gain", floor_db=-500.0, multipath=law)
        channel = replace(problem.channel, truth=setup)
        drawn = draw_truth(replace(problem, channel=channel), np.random.default_rng(0))
        values.append(drawn.raster.values)
    np.testing.assert_allclose(values[0], gain.values + 20.0, atol=1e-9)
    assert (values[1] - values[0]).std() == pytest.approx(Nakagami(2.0).std_db, rel=0.05)


def test_no_truth_and_no_log(problem):
    """There is nothing to measure: the key says where to put it."""
    channel = replace(problem.channel, truth=None)
    with pytest.raises(InputError, match=r"channel\.truth") as caught:
        prepare(replace(problem, channel=channel), 0)
    assert "channel.measurements.file" in str(caught.value)
    assert draw_truth(replace(problem, channel=channel), np.random.default_rng(0)) is None


def test_places_are_uniform():
    """In the courtyard as its area is, and never in the ring about it."""
    problem = small_problem(RING)
    places = free_places(problem, 4000, np.random.default_rng(0))
    assert places.shape == (4000, 2)
    assert not shapely.intersects(RING, shapely.points(places)).any()
    inside = ((places > (14.0, 9.0)) & (places < (26.0, 21.0))).all(axis=1).mean()
    share = 144.0 / (1200.0 - RING.area)
    assert inside == pytest.approx(share, abs=4.0 * np.sqrt(share / 4000))


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
