"""Display of results in notebooks."""

import base64
import re

import pytest

import planopt
from planopt.report.page_content import MOST_FIGURES, summary_html

HOSTILE = "<script>alert(1)</script>\" onerror='x'"


def picture_of(html: str) -> bytes:
    (found,) = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    return base64.b64decode(found)


@pytest.mark.parametrize("kind", ["solution", "simulation", "comparison"])
def test_results_display_picture_and_key_figures(kind: str, request: pytest.FixtureRequest) -> None:
    html = request.getfixturevalue(kind)._repr_html_()
    assert picture_of(html).startswith(b"\x89PNG")
    assert html.count("<tr>") == MOST_FIGURES
    assert "small" in html


def test_fits_and_maps_display_themselves() -> None:
    """With a picture; a fit has its parameters with errors."""
    belief = planopt.solve(planopt.load("open_field"), horizon=1).belief
    html = belief.fit._repr_html_()
    assert picture_of(html).startswith(b"\x89PNG")
    assert "path loss exponent" in html and "±" in html
    assert all(warning.split()[0] in html for warning in belief.fit.warnings)
    maps = planopt.channel.posterior_map(belief.posterior, (0.0, 0.0, 60.0, 40.0), 10.0, -60.0)
    html = maps._repr_html_()
    assert picture_of(html).startswith(b"\x89PNG")
    assert "P(connected) of 0.5 or more [%]" in html


def test_results_of_other_tasks() -> None:
    """A design without figures has its verdict and numbers."""
    result = planopt.solve(planopt.load("pursuit_design"))
    html = result._repr_html_()
    assert "verified" in html and html.count("<tr>") == MOST_FIGURES


def test_texts_are_escaped() -> None:
    html = summary_html(HOSTILE, [(HOSTILE, HOSTILE), ("none", None), ("nan", float("nan"))], None)
    assert "<script" not in html and '" onerror' not in html
    assert html.count("<tr>") == 1  # Missing values are left out
