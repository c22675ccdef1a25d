"""Figures as files, Matplotlib left as it was."""

import pkgutil
import subprocess
import sys

import matplotlib
import pytest
from artists import line_of, panel_of
from refusals import refused

import planopt.report
from planopt import OutputError
from planopt.report import draw_run_series, save_figure
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
