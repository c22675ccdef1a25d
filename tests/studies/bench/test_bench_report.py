"""The report's page and Markdown show the numbers that were scored."""

import json
import re
from pathlib import Path

import pytest
from bench_rows import row
from browser import opened

from planopt.commands.compare import report_json
from planopt.report import bench_page, page_markdown
from planopt.report.page import page_html
from planopt.studies.bench_cases import Manifest
from planopt.studies.bench_references import reference_of

HOSTILE = "<img src=x onerror=alert(1)>|"
MANIFEST = Manifest(
    program={"planopt": "0", "source": "0123456789abcdef", "casadi": "3"},
    python="3.11",
    cpu="a processor",
    cores=2,
    tolerances={"objective_share": 0.01},
    problems={"open_field": "0"},
)
ROWS = [
    row(planner="a", problem="open_field", bound=90.0, gap=0.08, late=0),
    row(planner="a", problem="open_field", seed=1, cpu_s=0.3, rungs={"lattice": 1}, late=1),
    row(planner=HOSTILE, problem="open_field", objective=110.0, bound=95.0, gap=0.15),
    row(planner=HOSTILE, problem="open_field", seed=1, accepted=False, reasons=("forged",)),
    row(planner="a", problem="open_field", kind="run", steps=20, cpu_s=0.4, rungs={"plan": 20}),
]
PAGE = bench_page(ROWS, {}, MANIFEST)


def table(title: str) -> list[dict[str, object]]:
    (found,) = (each for each in PAGE.tables if each.title.startswith(title))
    return [dict(zip(found.header, line, strict=True)) for line in found.rows]


def test_scores_by_start() -> None:
    """Cold and warm starts have tables of their own, with the numbers worked out by hand."""
    own, other = table("Scores, plans")
    assert (own["solved [%]"], other["solved [%]"]) == ("100.0", "0.0")
    assert (own["largest excess [%]"], other["largest excess [%]"]) == ("0.000", "10.000")
    # (100 - 90) / 100 and (110 - 95) / 110
    assert (own["median gap [%]"], other["median gap [%]"]) == ("10.00", "13.64")
    assert own["deadlines met"] == "1 of 2" and other["deadlines met"] == "-"
    assert other["rejected"] == 1 and own["proven bounds"] == 1
    # Mean of log(0.1 + 0.01) and log(0.3 + 0.01)
    assert own["mean time [s]"] == f"{(0.11 * 0.31) ** 0.5 - 0.01:.3f}"
    (warm,) = table("Scores, closed loops")
    assert (warm["planner"], warm["cases"], warm["mean time [s]"]) == ("a", 1, "0.020")


def test_families_and_questions() -> None:
    """Solved cases by family; a question has the tightest bound, and the class of its problem."""
    (family,) = table("Solved cases by family")
    assert (family["family"], family["a"], family[HOSTILE]) == ("thin walls", "3 of 3", "0 of 2")
    first, second, _ = table("Questions")
    assert (first["bound"], first["gap [%]"], first["best known"]) == (95.0, "10.00", 100.0)
    assert first["smoothed gap [%]"] == "8.00"
    assert (first["solved by"], first["difficulty"]) == ("a", "easy")
    assert (second["seed"], second["bound"]) == (1, None)


def test_charts_have_the_numbers() -> None:
    """Profiles, objectives, gaps, rates and fallbacks; axes have units."""
    charts = {chart.title.split(",")[0]: chart for chart in reversed(PAGE.charts)}
    profile = {each["name"]: each["y"][-1] for each in charts["Performance profile"].traces}
    assert list(profile.values()) == [100.0, 0.0]
    excess = charts["Objective against the best known"].traces
    assert [round(each["x"][-1], 6) for each in excess] == [1e-4, 10.0]
    gaps = [each["y"][0] for each in charts["Gap to the proven bound"].traces]
    assert [round(gap, 2) for gap in gaps] == [10.0, 13.64]
    fallbacks = {
        each["name"]: each["y"] for each in charts["Fallbacks that released the plans"].traces
    }
    assert fallbacks == {"plan": [21 / 22 * 100.0, 100.0], "lattice": [1 / 22 * 100.0, 0.0]}
    assert all(chart.x and "[%]" in chart.y for chart in PAGE.charts)


def test_markdown_has_the_numbers() -> None:
    """Aligned tables, escaped; regressions and rejections are in the JSON object."""
    words = page_markdown(PAGE)
    lines = [line for line in words.splitlines() if line.startswith("| a ")]
    assert [cell.strip() for cell in lines[0].split("|")[1:5]] == ["a", "2", "100.0", "100.0"]
    assert "onerror=alert(1)>\\|" in words and "limitation: " in words
    assert "a processor, 2 cores" in words and "objective_share 0.01" in words
    known = {one.case: one for one in (reference_of(each, "x") for each in ROWS)}
    known[ROWS[0].case] = reference_of(row(planner="a", problem="open_field", objective=90.0), "x")
    data = report_json(MANIFEST, ROWS, known)
    assert "objective 100, was 90: 11.1 % worse" in data["regressions"][0]
    assert "forged" in data["rejected"][0]
    assert (data["with_reference"], data["questions"], list(data["scores"])) == (
        5,
        3,
        ["plan", "run"],
    )


def test_page_is_one_escaped_file() -> None:
    text = page_html(PAGE)
    assert HOSTILE not in text and "onerror" in text
    assert not re.search(r"(src|href)=\"http", text.split("<script id")[0])
    found = re.search(r'<script id="content" type="application/json">(.*?)</script>', text, re.S)
    assert found is not None and len(json.loads(found[1])["charts"]) == len(PAGE.charts)


@pytest.mark.slow
def test_in_a_browser(tmp_path: Path) -> None:
    """Every chart is drawn with its points, on a phone too, and the console stays empty."""
    (tmp_path / "report.html").write_text(page_html(PAGE))
    with opened(tmp_path / "report.html") as (page, messages):
        page.wait_for_function(
            f"document.querySelectorAll('.js-plotly-plot').length === {len(PAGE.charts)}"
        )
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert page.locator("details[open] table").count() == len(PAGE.tables)
        assert page.evaluate("document.getElementById('chart0').data.length") == 2
        assert page.locator("svg .scatterlayer path.js-line").count() >= 4
        assert messages == []
