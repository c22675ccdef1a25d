"""Figures as files, Matplotlib left as it was, and figures of pursuits and networks."""

import pkgutil
import subprocess
import sys
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from artists import line_of, panel_of
from refusals import refused

import planopt.report
from planopt import OutputError
from planopt.pursuit import SnapshotService, Track
from planopt.report import draw_costs, draw_run_series, draw_step_times, draw_view, save_figure
from planopt.report.panel import new_figure


@pytest.fixture
def figure():
    return new_figure(2.0, 2.0)[0]


def test_import_leaves_matplotlib_alone():
    """Importing every module of the package loads no part of matplotlib."""
    modules = [
        f"planopt.report.{found.name}" for found in pkgutil.iter_modules(planopt.report.__path__)
    ]
    assert len(modules) > 8
    code = (
        f"import sys, {', '.join(modules)}\n"
        "print(any(name.split('.')[0] == 'matplotlib' for name in sys.modules))"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert answer.stdout.strip() == "False"


@pytest.mark.parametrize(
    ("ending", "magic"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")]
)
def test_formats(figure, tmp_path, ending, magic):
    """Each ending gives its format, without a date, in a folder made for it and nothing else."""
    files = [tmp_path / folder / f"figure{ending}" for folder in ("a", "b")]
    for path in files:
        save_figure(figure, path)
        assert path.read_bytes().startswith(magic)
        assert list(path.parent.iterdir()) == [path]
    assert ending == ".svg" or files[0].read_bytes() == files[1].read_bytes()


def test_refused_files(figure, tmp_path):
    """Another ending is an input error and a folder that is a file an output error."""
    for name in ("figure.bmp", "figure"):
        with refused():
            save_figure(figure, tmp_path / name)
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").touch()
    with pytest.raises(OutputError):
        save_figure(figure, tmp_path / "file" / "figure.png")


def test_nothing_global(simulation):
    """Drawing changes no global setting and registers no figure with pyplot."""
    before = dict(matplotlib.rcParams)
    axes = panel_of(draw_run_series(simulation), "received power")
    assert line_of(axes, "true") is not None
    assert dict(matplotlib.rcParams) == before


def test_view_of_one_mote():
    """Ages are of the finest level that shows a place; sub-cells hold the sampled positions."""
    service = SnapshotService(6, 1.0, 0.1, 2)
    generator = np.random.default_rng(0)
    tracks = [
        Track(np.array([0.0, 60.0]), np.stack([place, place + [3.0, -2.0]]))
        for place in generator.uniform(5.0, 55.0, (4, 2))
    ]
    mote = np.array([20, 33])
    panel = draw_view(service, tracks, mote, 60.0).axes[0]
    ages_s = np.asarray(panel.images[0].get_array())
    time_s = service.sample_numbers(60.0) * service.periods_s
    columns, rows = np.meshgrid(np.arange(64), np.arange(64))
    expected = np.full((64, 64), np.nan)
    for level in range(6, -1, -1):
        shown = (abs((columns >> level) - (mote[0] >> level)) <= 1) & (
            abs((rows >> level) - (mote[1] >> level)) <= 1
        )
        expected[shown] = 60.0 - time_s[level]
    np.testing.assert_allclose(ages_s, expected)
    squares = [line.get_xydata() for line in panel.lines if len(line.get_xdata()) == 5]
    paths = [line.get_xydata() for line in panel.lines if len(line.get_xdata()) == 2]
    assert len(squares) == len(paths) == len(tracks)
    for square, path in zip(squares, paths, strict=True):
        assert (square.min(axis=0) <= path[0]).all() and (path[0] <= square.max(axis=0)).all()


def test_charts_of_networks():
    """Costs of runs over time, and step times over the numbers of agents, in logarithms."""
    runs = {
        name: SimpleNamespace(times_s=np.arange(6.0), costs=scale * np.arange(5.0, 0.0, -1.0))
        for name, scale in (("law", 1.0), ("plan", 2.0))
    }
    axes = draw_costs(runs).axes[0]  # pyright: ignore[reportArgumentType]
    assert axes.get_yscale() == "log" and axes.get_xlabel() == "time [s]"
    for line, (name, run) in zip(axes.lines, runs.items(), strict=True):
        assert line.get_label() == name
        np.testing.assert_array_equal(line.get_xydata().T, [run.times_s[:-1], run.costs])
    axes = draw_step_times((10, 100), {"law": [0.1, 1.0], "plan": [0.2, 4.0]}).axes[0]
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert [list(line.get_ydata()) for line in axes.lines] == [[0.1, 1.0], [0.2, 4.0]]
    assert axes.lines[0].get_xdata().tolist() == pytest.approx([10.0, 100.0])
