"""Masks for Nav2, read by an independent reader of its format."""

import ast
from pathlib import Path

import numpy as np
import pytest
import yaml

import planopt
from planopt import InputError
from planopt.world.nav2_masks import MaskLimits, write_masks
from planopt.world.raster import Raster

UNKNOWN = -1


def served(path: Path) -> tuple[np.ndarray, float, tuple[float, float]]:
    """What Nav2's map server publishes: values [iy, ix] from 0 to 100, resolution and origin.

    Written after the description of ``mode`` in its documentation: trinary compares the darkness
    with both thresholds; scale maps it linearly from free_thresh (0) to occupied_thresh (100).
    """
    keys = yaml.safe_load(path.read_text())
    lines = (path.parent / keys["image"]).read_bytes().split(b"\n", 3)
    assert lines[0] == b"P5" and lines[2] == b"255"
    columns, rows = map(int, lines[1].split())
    pixels = np.frombuffer(lines[3], dtype=np.uint8)
    assert pixels.size == rows * columns
    dark = 1.0 - pixels.reshape(rows, columns)[::-1] / 255.0
    assert keys["negate"] == 0
    low, high = keys["free_thresh"], keys["occupied_thresh"]
    if keys["mode"] == "trinary":
        found = np.where(dark > high, 100, np.where(dark < low, 0, UNKNOWN))
    else:
        assert keys["mode"] == "scale"
        linear = np.rint((dark - low) / (high - low) * 100.0)
        found = np.where(dark > high, 100, np.where(dark < low, 0, linear))
    assert keys["origin"][2] == 0.0
    return found.astype(int), keys["resolution"], tuple(keys["origin"][:2])


def test_every_probability(tmp_path: Path) -> None:
    """Each value is what the definition says, in its place."""
    x, y = 10.25 + 0.5 * np.arange(40), -3.75 + 0.5 * np.arange(30)
    generator = np.random.default_rng(0)
    probability = generator.uniform(size=(30, 40))
    probability[0, :4] = (0.0, 0.1, 0.9, 1.0)
    write_masks(tmp_path, Raster(x, y, probability), MaskLimits(0.1, 0.9))
    expected = {
        "keepout": np.where(probability < 0.1, 100, 0),
        "weighted": np.minimum(np.rint(100.0 * (1.0 - probability)), 99),
        "contact": np.where(probability >= 0.9, 100, 0),
    }
    for name, values in expected.items():
        found, resolution, origin = served(tmp_path / f"{name}.yaml")
        np.testing.assert_array_equal(found, values)
        assert resolution == pytest.approx(0.5) and origin == pytest.approx((10.0, -4.0))


def test_the_filters_are_those_of_the_masks(tmp_path: Path) -> None:
    """Topics agree between servers, infos and filters; types and factors are Nav2's."""
    axis = 0.5 + np.arange(3.0)
    write_masks(tmp_path, Raster(axis, axis, np.full((3, 3), 0.5)), MaskLimits())
    nodes = yaml.safe_load((tmp_path / "nav2_filters.yaml").read_text())
    costmap = nodes["global_costmap"]["global_costmap"]["ros__parameters"]
    plugins = {"keepout": ("KeepoutFilter", 0), "weighted": ("KeepoutFilter", 0)}
    for name, (plugin, kind) in {**plugins, "contact": ("BinaryFilter", 3)}.items():
        server = nodes[f"{name}_mask_server"]["ros__parameters"]
        info = nodes[f"{name}_filter_info_server"]["ros__parameters"]
        layer = costmap[f"{name}_filter"]
        assert (tmp_path / server["yaml_filename"]).is_file()
        assert server["topic_name"] == info["mask_topic"]
        assert info["filter_info_topic"] == layer["filter_info_topic"]
        assert (info["type"], info["base"], info["multiplier"]) == (kind, 0.0, 1.0)
        assert layer["plugin"] == f"nav2_costmap_2d::{plugin}"
        assert f"{name}_filter" in costmap["filters"]
    assert costmap["contact_filter"]["flip_threshold"] == 50.0
    ast.parse((tmp_path / "nav2_filters.launch.py").read_text())


@pytest.mark.parametrize("limits", [(-0.1, 0.9), (0.1, 1.1), (float("nan"), 0.9)])
def test_limits_that_are_none(limits: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="probability"):
        MaskLimits(*limits)


def test_cells_that_are_not_square(tmp_path: Path) -> None:
    x, y = np.arange(3.0), 2.0 * np.arange(3.0)
    with pytest.raises(InputError, match="not square"):
        write_masks(tmp_path, Raster(x, y, np.full((3, 3), 0.5)), MaskLimits())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("task", ["solve", "simulate"])
def test_of_a_result(task: str, tmp_path: Path) -> None:
    """A result's masks are those of its belief: at the start for a solution, the end for a run."""
    problem = planopt.load("two_station_courier")
    result = getattr(planopt, task)(problem, horizon=2, seed=1)
    result.to_nav2(tmp_path, p_min=0.7, keepout_below=0.3, cell_m=10.0)
    found, resolution, origin = served(tmp_path / "weighted.yaml")
    rows, columns = np.indices(found.shape)
    places = np.array(origin) + resolution * (np.stack([columns, rows], axis=-1) + 0.5)
    missed = np.ones(found.size)
    for posterior, station in zip(result.belief.posteriors, problem.stations, strict=True):
        missed *= 1.0 - posterior.connectivity(places.reshape(-1, 2), station.threshold_dbm)
    chance = 1.0 - missed.reshape(found.shape)
    np.testing.assert_array_equal(found, np.minimum(np.rint(100.0 * (1.0 - chance)), 99))
    np.testing.assert_array_equal(served(tmp_path / "contact.yaml")[0] > 0, chance >= 0.7)
    np.testing.assert_array_equal(served(tmp_path / "keepout.yaml")[0] > 0, chance < 0.3)
