"""Figures as files."""

import pytest
from artists import line_of, panel_of

from planopt.errors import InputError, OutputError
from planopt.report.motion_figures import draw_run_series
from planopt.report.panel import new_figure
from planopt.report.saving import save_figure


@pytest.mark.parametrize(
    ("ending", "magic"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")]
)
def test_formats(tmp_path, ending, magic):
    """Each ending gives its format, in a folder made for it, and leaves nothing else."""
    path = tmp_path / "new" / f"figure{ending}"
    save_figure(new_figure(2.0, 2.0), path)
    assert path.read_bytes().startswith(magic)
    assert list(path.parent.iterdir()) == [path]


def test_same_figure_same_bytes(tmp_path):
    """Files carry no date."""
    for name in ("a", "b"):
        save_figure(new_figure(2.0, 2.0), tmp_path / f"{name}.pdf")
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()


@pytest.mark.parametrize("name", ["figure.bmp", "figure"])
def test_other_endings(tmp_path, name):
    """Another ending is an input error that lists those there are; no file appears."""
    with pytest.raises(InputError, match=r"\.png, \.svg, \.pdf"):
        save_figure(new_figure(2.0, 2.0), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_unwritable(tmp_path):
    """A folder that is a file is an output error."""
    (tmp_path / "file").touch()
    with pytest.raises(OutputError):
        save_figure(new_figure(2.0, 2.0), tmp_path / "file" / "figure.png")


def test_nothing_global(simulation):
    """Drawing changes no global setting and registers no figure with pyplot."""
    import matplotlib

    before = dict(matplotlib.rcParams)
    axes = panel_of(draw_run_series(simulation), "received power")
    assert line_of(axes, "true") is not None
    assert dict(matplotlib.rcParams) == before
