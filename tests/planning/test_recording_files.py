"""Recordings of results, read by the libraries of their formats."""

import base64
import json
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

import planopt
from planopt.cli import main
from planopt.planning.files import path_files as recordings

SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def run() -> planopt.Run:
    run = planopt.simulate(planopt.load("open_field"), horizon=2)
    assert isinstance(run, planopt.Run)
    return run


def messages_of(path: Path) -> dict[str, list]:
    """Time, schema and content of each message by topic; each content is valid by its schema."""
    reader = pytest.importorskip("mcap.reader")
    jsonschema = pytest.importorskip("jsonschema")
    found = defaultdict(list)
    with path.open("rb") as file:
        for schema, channel, message in reader.make_reader(file).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            declared = json.loads(schema.data)
            assert declared["title"] == schema.name
            content = json.loads(message.data)
            jsonschema.validate(content, declared)
            assert set(content) <= set(declared["properties"])
            found[channel.topic].append((message.log_time / SECOND, schema.name, content))
    return found


def test_mcap(run: planopt.Run, tmp_path: Path) -> None:
    """Poses and powers are those of the log, plans begin at the poses, the map is the last one."""
    run.save_recording(tmp_path / "run.mcap")
    found = messages_of(tmp_path / "run.mcap")
    log = run.run.log
    poses = found["/rover/pose"]
    assert {name for _, name, _ in poses} == {"foxglove.PoseInFrame"}
    np.testing.assert_allclose([time for time, _, _ in poses], log.t_s)
    places = [each["pose"]["position"] for _, _, each in poses]
    np.testing.assert_array_equal([(each["x"], each["y"]) for each in places], log.positions_m)
    turns = [each["pose"]["orientation"] for _, _, each in poses]
    headings = np.array([2.0 * np.arctan2(each["z"], each["w"]) for each in turns])
    steps = np.diff(log.positions_m, axis=0)
    along = np.stack([np.cos(headings), np.sin(headings)], axis=1)[:-1]
    np.testing.assert_allclose(along * np.linalg.norm(steps, axis=1)[:, None], steps, atol=1e-9)
    received = [each["received_dbm"] for _, _, each in found["/rover/link"]]
    np.testing.assert_array_equal(received, log.true_dbm)
    plans = found["/rover/plan"]
    assert len(plans) == len(log.t_s) - 1
    for (_, _, plan), place in zip(plans, log.positions_m, strict=False):
        first = plan["poses"][0]["position"]
        np.testing.assert_allclose((first["x"], first["y"]), place)
    ((_, name, scene),) = found["/obstacles"]
    assert name == "foxglove.SceneUpdate" and len(scene["entities"]) == 3


def test_map_in_mcap(run: planopt.Run, tmp_path: Path) -> None:
    """Each cell of the grid, by its position, has the posterior's prediction."""
    run.save_recording(tmp_path / "run.mcap")
    ((_, _, grid),) = messages_of(tmp_path / "run.mcap")["/map"]
    cells = np.frombuffer(base64.b64decode(grid["data"]), "<f4")
    cells = cells.reshape(-1, grid["column_count"], len(grid["fields"]))
    assert grid["row_stride"] == cells[0].nbytes and grid["cell_stride"] == cells[0, 0].nbytes
    rows, columns = np.indices(cells.shape[:2])
    corner, size = grid["pose"]["position"], grid["cell_size"]
    x = corner["x"] + size["x"] * (columns + 0.5)
    y = corner["y"] + size["y"] * (rows + 0.5)
    places = np.stack([x.ravel(), y.ravel()], axis=1)
    expected = run.belief.posterior.connectivity(places, -59.0)
    assert grid["fields"][0]["name"] == "connectivity"
    np.testing.assert_allclose(cells[..., 0].ravel(), expected, atol=1e-6)


def test_of_a_plan_and_a_saved_run(run: planopt.Run, tmp_path: Path, capsys) -> None:
    """A plan is one message at its start; the command reads a folder."""
    plan = planopt.solve(planopt.load("two_station_courier"), horizon=3)
    plan.save_recording(tmp_path / "plan.mcap")
    found = messages_of(tmp_path / "plan.mcap")
    (topic,) = (name for name in found if name.endswith("/plan"))
    assert len(found[topic]) == 1 and len(found[topic][0][2]["poses"]) == 4
    run.save(tmp_path / "run")
    assert main(["path", str(tmp_path / "run"), "--out", str(tmp_path / "a.mcap")]) == 0
    run.save_recording(tmp_path / "b.mcap")
    assert messages_of(tmp_path / "a.mcap") == messages_of(tmp_path / "b.mcap")


def test_rerun(run: planopt.Run, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    run.save_recording(tmp_path / "run.rrd")
    content = (tmp_path / "run.rrd").read_bytes()
    assert content.startswith(b"RRF") and len(content) > 10_000


def test_recordings_that_cannot_be_written(
    run: planopt.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with refused():
        run.save_recording(tmp_path / "run.bag")

    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(recordings, "import_module", missing)
    for ending in ("mcap", "rrd"):
        with refused():
            run.save_recording(tmp_path / f"run.{ending}")
    assert not list(tmp_path.iterdir())
