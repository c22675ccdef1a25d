"""Pictures of the gallery: every new figure or animation among an example's variables, in order.

planopt's figures do not belong to pyplot, where Sphinx-Gallery looks for them by itself.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

from planopt.report import save_figure


def scrape(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save the figures and animations that a block made, and return the text that shows them."""
    seen: set[int] = block_vars["example_globals"].setdefault("__figures_seen__", set())
    paths: list[str] = []
    for value in block_vars["example_globals"].values():
        if isinstance(value, Figure) and id(value) not in seen:
            seen.add(id(value))
            path = next(block_vars["image_path_iterator"])
            save_figure(value, Path(path))
            paths.append(path)
        if isinstance(value, Path) and value.suffix == ".gif" and id(value) not in seen:
            seen.add(id(value))
            path = Path(next(block_vars["image_path_iterator"])).with_suffix(".gif")
            shutil.copyfile(value, path)
            paths.append(str(path))
    return figure_rst(paths, gallery_conf["src_dir"])
