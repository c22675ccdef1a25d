"""Display of results in notebooks: a picture and key figures as HTML, for ``_repr_html_``."""

from __future__ import annotations

import io
from base64 import b64encode
from collections.abc import Iterable
from html import escape
from itertools import islice
from typing import TYPE_CHECKING, Any, cast

from planopt.channel.parameters import PARAMETER_WORDS
from planopt.report.channel_figures import draw_fit, draw_posterior_map
from planopt.report.page import cell_text
from planopt.report.panel import DPI
from planopt.report.tables import figures_in_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from planopt.channel.channel_map import PosteriorMap
    from planopt.channel.estimation.channel_fit import ChannelFit

MOST_FIGURES = 5
"""Number of key figures next to the picture."""


def fit_html(fit: ChannelFit) -> str:
    """Return a fit as HTML: fitted curves, standard errors and warnings."""
    figures = [
        ("status", f"{fit.status}, by {fit.method} from {fit.measurements} measurements"),
        *(
            (
                PARAMETER_WORDS[name][0],
                f"{getattr(fit.parameters, name):.4g} ± {error:.2g} {PARAMETER_WORDS[name][1]}",
            )
            for name, error in fit.standard_errors.items()
        ),
    ]
    notes = "".join(f"<li>{escape(each)}</li>" for each in fit.warnings)
    picture = draw_fit(None, fit, fit.parameters.station)
    return summary_html("channel fit", figures, picture, len(figures)) + f"<ul>{notes}</ul>"


def map_html(maps: PosteriorMap) -> str:
    """Return a map as HTML."""
    x, y = maps.mean_db.x_m, maps.mean_db.y_m
    figures = [
        ("x", f"{x[0]:g} to {x[-1]:g} m"),
        ("y", f"{y[0]:g} to {y[-1]:g} m"),
        ("cell_m", maps.mean_db.cell_m[0]),
        ("threshold_dbm", maps.threshold_dbm),
        ("connected_share", float((maps.connectivity.values >= 0.5).mean())),
    ]
    return summary_html("radio map", figures, draw_posterior_map(maps, None, (), "radio map"))


def summary_html(
    title: str,
    figures: Iterable[tuple[str, object]],
    picture: Figure | None,
    most: int = MOST_FIGURES,
) -> str:
    """Return HTML with the first key figures as a table, and the picture, if any."""
    rows = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(cell_text(value))}</td></tr>'
        for name, value in islice(figures_in_words(figures), most)
    )
    image = ""
    if picture is not None:
        content = io.BytesIO()
        cast("Any", picture).savefig(content, format="png", dpi=DPI)
        source = f"data:image/png;base64,{b64encode(content.getvalue()).decode()}"
        image = f'<img style="max-width:100%" alt="{escape(title)}" src="{source}">'
    return f"<table><caption>{escape(title)}</caption>{rows}</table>{image}"
