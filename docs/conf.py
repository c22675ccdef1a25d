"""Sphinx configuration."""

from __future__ import annotations

import sys
from pathlib import Path

from sphinx.application import Sphinx

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from problem_keys import write_problem_keys  # noqa: E402

project = "planopt"
copyright = "2026, the planopt authors"
author = "the planopt authors"
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "numpydoc",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "gallery", "lab"]
html_theme = "furo"
html_title = "planopt"
autodoc_typehints = "none"
autodoc_class_signature = "separated"
numpydoc_show_class_members = False
myst_heading_anchors = 3
myst_enable_extensions = ["amsmath", "dollarmath"]
sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "auto_examples",
    "image_scrapers": ["figure_scraper.scrape"],
    "reset_modules": (),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
}


def setup(app: Sphinx) -> None:
    """Write what is generated from the code before pages are read."""
    app.connect("builder-inited", lambda _: write_problem_keys(HERE / "_build" / "problem_keys.md"))
