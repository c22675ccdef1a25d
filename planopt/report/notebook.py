"""Display of results in notebooks: a picture and key figures as HTML, for ``_repr_html_``."""

from __future__ import annotations

import io
from base64 import b64encode
from collections.abc import Iterable
from html import escape
from itertools import islice
from typing import TYPE_CHECKING, Any, cast

from planopt.report.page import cell_text
from planopt.report.page_content import key_figures
from planopt.report.panel import DPI

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from planopt.planning.loop.results import Run, Solution

MOST_FIGURES = 5
"""Number of key figures next to the picture."""


def result_html(result: Solution | Run) -> str:
    """Return a motion plan or run as HTML."""
    return summary_html(result.problem.name, key_figures(result), result.plot())


def summary_html(title: str, figures: Iterable[tuple[str, object]], picture: Figure | None) -> str:
    """Return HTML with the first key figures as a table, and the picture, if any."""
    rows = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(cell_text(value))}</td></tr>'
        for name, value in islice(figures, MOST_FIGURES)
    )
    image = ""
    if picture is not None:
        content = io.BytesIO()
        cast("Any", picture).savefig(content, format="png", dpi=DPI)
        source = f"data:image/png;base64,{b64encode(content.getvalue()).decode()}"
        image = f'<img style="max-width:100%" alt="{escape(title)}" src="{source}">'
    return f"<table><caption>{escape(title)}</caption>{rows}</table>{image}"
