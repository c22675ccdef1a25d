"""Paths for other programs, read back as these read them."""

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import refused, refused_command

import planopt
from planopt.cli import main
from planopt.planning.files.path_files import RobotPath, path_of_result, ros_text
from planopt.world.geodesy import east_north_m

ORIGIN = (48.1374, 11.5755)


@pytest.fixture(scope="module")
def solution() -> planopt.Solution:
    """A short plan in the open field."""
    return planopt.solve(planopt.load("open_field"), horizon=3)


def there(degrees: np.ndarray) -> np.ndarray:
    return east_north_m(degrees[:, 0], degrees[:, 1], ORIGIN)


def test_ros(solution: planopt.Solution, tmp_path: Path) -> None:
    """Stamps are times, quaternions have unit length and point to the next position."""
    solution.save_path(tmp_path / "path.json")
    data = json.loads((tmp_path / "path.json").read_text())
    assert data["header"]["frame_id"] == "map"
    poses = [each["pose"] for each in data["poses"]]
    places = np.array([[each["position"][axis] for axis in "xy"] for each in poses])
    np.testing.assert_array_equal(places, solution.plan.positions_m)
    stamps = [each["header"]["stamp"] for each in data["poses"]]
    times = [each["sec"] + each["nanosec"] * 1e-9 for each in stamps]
    np.testing.assert_allclose(times, solution.plan.t_s)
    yaw = np.array([2.0 * np.arctan2(e["orientation"]["z"], e["orientation"]["w"]) for e in poses])
    steps = np.diff(places, axis=0)
    np.testing.assert_allclose(
        np.column_stack([np.cos(yaw), np.sin(yaw)])[:-1] * np.linalg.norm(steps, axis=1)[:, None],
        steps,
        atol=1e-12,
    )


def test_a_robot_that_stands() -> None:
    """It keeps its heading; at the start it has that of its first step."""
    places = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 2.0], [0.0, 2.0]])
    path = RobotPath("a", np.arange(4.0), places, np.full(4, np.nan), 1.0)
    np.testing.assert_allclose(path.headings_rad, np.pi / 2.0)
    still = replace(path, positions_m=np.zeros((4, 2)))
    np.testing.assert_array_equal(still.headings_rad, 0.0)
    assert json.loads(ros_text(still))["poses"][3]["header"]["stamp"] == {"sec": 3, "nanosec": 0}


def test_geojson_and_qgroundcontrol(solution: planopt.Solution, tmp_path: Path) -> None:
    """Degrees of both are the positions; the mission is complete for its reader."""
    solution.save_path(tmp_path / "path.geojson", origin_deg=ORIGIN)
    (feature,) = json.loads((tmp_path / "path.geojson").read_text())["features"]
    assert feature["geometry"]["type"] == "LineString"
    places = there(np.array(feature["geometry"]["coordinates"]))
    np.testing.assert_allclose(places, solution.plan.positions_m, atol=1e-3)
    assert feature["properties"]["t_s"] == solution.plan.t_s.tolist()
    solution.save_path(tmp_path / "path.plan", origin_deg=ORIGIN, altitude_m=30.0)
    plan = json.loads((tmp_path / "path.plan").read_text())
    assert (plan["fileType"], plan["version"], plan["mission"]["vehicleType"]) == ("Plan", 1, 2)
    items = plan["mission"]["items"]
    assert [each["doJumpId"] for each in items] == list(range(1, len(items) + 1))
    assert all(each["command"] == 16 and each["params"][6] == 30.0 for each in items)
    degrees = np.array([each["params"][5:3:-1] for each in items])
    np.testing.assert_allclose(there(degrees), solution.plan.positions_m, atol=1e-3)


def test_csv_of_a_saved_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command reads a saved run; degrees are added if the origin is given."""
    run = planopt.simulate(planopt.load("open_field"), horizon=2, seed=1)
    run.save(tmp_path / "run")
    log = run.run.log
    for more, count in (([], 5), (["--origin", "48.1374,11.5755", "--robot", "rover"], 7)):
        out = tmp_path / "path.csv"
        assert main(["path", str(tmp_path / "run"), "--out", str(out), *more, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["positions"] == len(log.t_s)
        header, *rows = csv.reader(io.StringIO(out.read_text()))
        assert len(header) == count
        table = np.array([[float(cell or "nan") for cell in row] for row in rows])
        np.testing.assert_array_equal(table[:, :3], np.column_stack([log.t_s, log.positions_m]))
        if count == 7:
            np.testing.assert_allclose(there(table[:, [6, 5]]), log.positions_m, atol=1e-3)


def test_refusals(solution: planopt.Solution, tmp_path: Path, capsys) -> None:
    """A missing origin, unknown endings and robots; nothing is written."""
    with refused():
        solution.save_path(tmp_path / "path.geojson")
    with refused():
        solution.save_path(tmp_path / "path.kml")
    with refused():
        solution.save_path(tmp_path / "path.csv", robot="nobody")
    with refused():
        solution.save_path(tmp_path / "path.csv", robot=1)
    with refused():
        solution.save_path(tmp_path / "path.plan", origin_deg=(91.0, 0.0))
    with refused():
        solution.save_path(tmp_path / "path.plan", origin_deg=ORIGIN, altitude_m=float("nan"))
    refused_command(capsys, "path", tmp_path / "absent", "--out", tmp_path / "path.csv")
    assert not list(tmp_path.iterdir())


def test_the_origin_of_the_log(solution: planopt.Solution, tmp_path: Path) -> None:
    """A problem made from a log in degrees has the origin already."""
    from planopt.channel import LogFormat
    from planopt.problems import LoggedMeasurements

    log = LoggedMeasurements(Path("log.csv"), LogFormat(origin_deg=ORIGIN))
    channel = replace(solution.problem.channel, measurements=log)
    result = replace(solution, problem=replace(solution.problem, channel=channel))
    assert path_of_result(result).origin_deg == ORIGIN
    result.save_path(tmp_path / "path.geojson")
