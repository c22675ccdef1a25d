"""The gallery's pages of the paper's figures, and what no page may name."""

from pathlib import Path

import pytest

GALLERY = Path(__file__).parents[1] / "docs" / "gallery"


@pytest.mark.parametrize("number", range(1, 6))
def test_every_figure_has_its_command_and_an_animation(number: int) -> None:
    """The command that makes the comparison, and one run as a GIF."""
    page = (GALLERY / f"plot_fig{number}.py").read_text(encoding="utf-8")
    assert f"``planopt compare fig{number}``" in page
    assert f'"fig{number}.gif"' in page and "save_animation(" in page


@pytest.mark.parametrize("page", sorted(GALLERY.glob("plot_*.py")), ids=lambda page: page.stem)
def test_pages_name_no_path_outside_the_repository(page: Path) -> None:
    """Data that are not part of planopt are where the environment says."""
    text = page.read_text(encoding="utf-8")
    assert "../" not in text and "shared" not in text and "__file__" not in text
