"""Sphinx configuration."""

from __future__ import annotations

import inspect
import sys
from pathlib import Path
from typing import get_type_hints

from sphinx.application import Sphinx
from sphinx.util.inspect import stringify_signature

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
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
maximum_signature_line_length = 88
autodoc_class_signature = "mixed"
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


def plain_types(
    app: Sphinx, what: str, name: str, obj: object, options: object, signature: str, returned: str
) -> tuple[str, str] | None:
    """Return a class's signature without the ranges and descriptions of annotated fields."""
    if what != "class" or "Annotated[" not in signature:
        return None
    hints = get_type_hints(obj)
    shown = inspect.signature(obj)
    parameters = [
        each.replace(annotation=hints.get(each.name, each.empty))
        for each in shown.parameters.values()
    ]
    plain = shown.replace(parameters=parameters, return_annotation=inspect.Signature.empty)
    return stringify_signature(plain, unqualified_typehints=True), returned


def setup(app: Sphinx) -> None:
    """Write the page of problem keys before pages are read, and shorten signatures."""
    app.connect("builder-inited", lambda _: write_problem_keys(HERE / "_build" / "problem_keys.md"))
    app.connect("autodoc-process-signature", plain_types)
