"""HTML pages of results: self-contained, escaped, operable by keyboard, complete."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from browser import opened

import planopt
from planopt.cli import main
from planopt.files.tables import Column
from planopt.problems.tasks import Contents
from planopt.report.page import MOST_ROWS, Chart, Page, PageTable, page_html, plain
from planopt.report.page_content import task_page

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)> & \"'"


class Elements(HTMLParser):
    """Elements of a page with their attributes, and the text of each kind."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, list[str]] = {}
        self._open = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        self._open = tag

    def handle_data(self, data: str) -> None:
        self.texts.setdefault(self._open, []).append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.found if name == tag]


def content_of(text: str) -> dict:
    found = re.search(r'<script id="content" type="application/json">(.*?)</script>', text, re.S)
    assert found is not None
    return json.loads(found[1])


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One folder for every kind of result."""
    folder = tmp_path_factory.mktemp("saved")
    field = planopt.load("open_field")
    results = {
        "plan": planopt.solve(field, horizon=3),
        "run": planopt.simulate(field, horizon=2),
        "comparison": planopt.compare(field, horizons=[1, 2], costs_to_go=["connected"], seeds=2),
        "network": planopt.simulate(planopt.load("coverage_plain")),
        "deployment": planopt.solve(planopt.load("coverage_plain")),
        "pursuit": planopt.simulate(planopt.load("pursuit_fleeing")),
    }
    for name, result in results.items():
        result.save(folder / name)
    return {name: folder / name for name in results}


@pytest.fixture(scope="module")
def pages(saved: dict[str, Path]) -> dict[str, str]:
    for folder in saved.values():
        assert main(["report", str(folder), "--json"]) == 0
    return {name: (folder / "report.html").read_text() for name, folder in saved.items()}


KINDS = ("plan", "run", "comparison", "network", "deployment", "pursuit")


@pytest.mark.parametrize("kind", KINDS)
def test_page_is_accessible_and_self_contained(kind: str, pages: dict[str, str]) -> None:
    """Language, title, headings, labelled controls and tables; no element loads anything."""
    elements = Elements(pages[kind])
    assert elements.all("html") == [{"lang": "en"}]
    assert len(elements.all("h1")) == len(elements.all("title")) == 1
    assert any(each.get("name") == "viewport" for each in elements.all("meta"))
    policy = [each["content"] or "" for each in elements.all("meta") if "http-equiv" in each]
    assert len(policy) == 1 and "default-src 'none'" in policy[0] and "http" not in policy[0]
    for _, attributes in elements.found:
        for name in ("src", "href", "action", "data", "srcset"):
            assert (attributes.get(name) or "#").startswith(("#", "data:"))
        assert not any(name.startswith("on") for name in attributes)
    tables, captions = len(elements.all("table")), len(elements.all("caption"))
    assert tables == captions >= 3
    assert all(each["scope"] == "col" for each in elements.all("th"))
    scrolling = [each for each in elements.all("div") if each.get("class") == "scroll"]
    assert all(each["tabindex"] == "0" and each["aria-label"] for each in scrolling)
    assert "Plotly" in pages[kind]


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "comparison"])
def test_slider_has_every_step(kind: str, saved: dict[str, Path], pages: dict[str, str]) -> None:
    """Controls are native elements with labels; the map has every position of every path."""
    elements = Elements(pages[kind])
    (slider,) = elements.all("input")
    assert slider["type"] == "range" and {"for": "step"} in elements.all("label")
    assert len(elements.all("select")) == len(elements.all("button")) == 1
    drawn = content_of(pages[kind])["map"]
    (file,) = saved[kind].glob("*.json")
    robots = json.loads(file.read_text())["robots"]
    assert drawn["times"] == pytest.approx(robots[0]["t_s"], abs=1e-3)
    tracks = [track for group in drawn["groups"] for track in group["tracks"]]
    assert len(tracks) == len(robots)
    for robot in robots:
        assert any(track["x"] == pytest.approx(robot["x_m"], abs=1e-3) for track in tracks)


def test_map_of_a_run(saved: dict[str, Path], pages: dict[str, str]) -> None:
    """Layers, obstacles, the plan of each step from the robot's position, and the charts."""
    run = planopt.load_result(saved["run"])
    assert isinstance(run, planopt.Run)
    content = content_of(pages["run"])
    drawn = content["map"]
    layers = {layer["name"]: layer for layer in drawn["layers"]}
    assert list(layers) == ["P(connected)", "predicted power", "standard deviation"]
    known = [value for row in layers["P(connected)"]["z"] for value in row if value is not None]
    assert known and min(known) >= 0.0 and max(known) <= 1.0
    assert layers["P(connected)"]["mark"] == run.problem.constraints.p_min
    assert [each["name"] for each in drawn["obstacles"]] == ["obstacles"]
    (group,) = drawn["groups"]
    (track,) = group["tracks"]
    steps = len(run.run.log.t_s) - 1
    assert len(track["notes"]) == steps + 1 and len(track["plans"]) == steps + 1
    for step in range(steps):
        assert track["plans"][step]["x"][0] == track["x"][step]
        assert track["plans"][step]["y"][0] == track["y"][step]
    assert sum(chart["over_time"] for chart in content["charts"]) == 2
    received = [
        trace
        for chart in content["charts"]
        for trace in chart["traces"]
        if trace["name"].endswith(", received")
    ]
    assert received[0]["y"] == pytest.approx(run.run.log.true_dbm, abs=0.01)
    words = Elements(pages["run"]).texts
    assert "plans verified" in "".join(words["pre"])


def test_events_are_on_the_map(tmp_path: Path) -> None:
    """An event is drawn while it is there; the charts of its table leave positions out."""
    times, there = np.arange(4.0), np.array([0, 1, 1, 0])
    names = np.array(["leak"] * 4)
    table = {"event": names, "t_s": times, "there": there, "x_m": times, "y_m": 2.0 * times}
    columns = [Column("event", "", kind="text"), Column("t_s", "time", "s"), Column("x_m", "", "m")]
    robot = {"name": "agent0", "t_s": [0.0, 3.0], "x_m": [0.0, 1.0], "y_m": [0.0, 1.0]}
    contents = Contents("run.json", {"robots": [robot]}, {"events.csv": (columns, table)})
    task = SimpleNamespace(
        contents=lambda _: contents, tables=lambda _: {}, key_figures=lambda _: ()
    )
    problem = SimpleNamespace(name="net", description="", obstacles=())
    page = task_page(SimpleNamespace(problem=problem, task=task, words=()))
    assert page.map is not None and not page.charts
    groups = content_of(page_html(page))["map"]["groups"]
    (track,) = groups[1]["tracks"]
    assert groups[1]["symbol"] == "star"
    assert track["x"] == [None, 1.0, 2.0, None] and track["y"] == [None, 2.0, 4.0, None]


@pytest.mark.parametrize("kind", ["plan", "run", "network"])
def test_key_figures_are_words(kind: str, pages: dict[str, str]) -> None:
    """No keys and no JSON; every row has a value."""
    table = pages[kind].split("Key figures")[-1].split("</table>")[0]
    cells = re.findall(r"<td[^>]*>(.*?)</td>", table)
    assert cells and all(cells)
    assert not any("_" in cell or "[{" in cell or cell == "[]" for cell in cells[::2])


def test_plan_states_its_certificate(pages: dict[str, str]) -> None:
    text = "".join(Elements(pages["plan"]).texts["pre"])
    assert text.count("initial guess") <= 1  # The certificate does not repeat the result
    assert "KKT residual" in text and "clearance" in text and "P(connected)" in text


def test_comparison_has_a_chart_per_metric(saved: dict[str, Path], pages: dict[str, str]) -> None:
    comparison = planopt.load_result(saved["comparison"])
    assert isinstance(comparison, planopt.Comparison)
    content = content_of(pages["comparison"])
    metrics = {row.metric for row in comparison.rows}
    reliability = 1 if comparison.reliability else 0
    assert content["map"] is None and len(content["charts"]) == len(metrics) + reliability
    for chart in content["charts"][: len(metrics)]:
        assert len(chart["traces"][1]["x"]) <= len(comparison.settings)


def test_texts_of_files_are_escaped(saved: dict[str, Path], tmp_path: Path) -> None:
    """Hostile texts in a file reach neither HTML nor the script nor Plotly as markup."""
    (file,) = saved["pursuit"].glob("*.json")
    data = json.loads(file.read_text())
    data["robots"][0]["name"] = data["robots"][1]["role"] = data["reason"] = HOSTILE
    data["problem_file"]["problem"]["description"] = HOSTILE
    (tmp_path / file.name).write_text(json.dumps(data))
    assert main(["report", str(tmp_path)]) == 0
    text = (tmp_path / "report.html").read_text()
    elements = Elements(text)
    assert len(elements.all("script")) == 3 and not elements.all("img")
    assert HOSTILE in "".join(elements.texts["p"])
    assert HOSTILE in "".join(elements.texts["td"])
    groups = content_of(text)["map"]["groups"]
    assert groups[0]["name"] == HOSTILE


def test_tables_and_labels() -> None:
    """Long tables are cut, and HTML in labels is escaped."""
    assert plain("<a href='x'>&") == "&lt;a href='x'&gt;&amp;"
    chart = Chart(HOSTILE, [{"type": "scatter", "name": plain(HOSTILE)}], "x", "y")
    text = page_html(Page(HOSTILE, HOSTILE, [HOSTILE], [HOSTILE], charts=[chart]))
    elements = Elements(text)
    assert len(elements.all("script")) == 3 and not elements.all("img")
    assert elements.texts["h1"] == [HOSTILE]
    assert elements.texts["figcaption"][0] == HOSTILE
    rows = [(number, None, float("nan")) for number in range(MOST_ROWS)]
    table = PageTable("t", ("a", "b", "c"), rows, MOST_ROWS + 5, "steps.csv")
    text = page_html(Page("title", "", (), tables=[table]))
    assert f"The first {MOST_ROWS} of {MOST_ROWS + 5} rows. The others are in steps.csv." in text
    assert "nan" not in text.split("</table>")[0]


def test_new_results_remove_the_page(saved: dict[str, Path], tmp_path: Path) -> None:
    """A page never describes an older result than the files next to it."""
    result = planopt.load_result(saved["network"])
    result.save(tmp_path)
    assert main(["report", str(tmp_path / "run.json")]) == 0
    assert (tmp_path / "report.html").is_file()
    result.save(tmp_path)
    assert not (tmp_path / "report.html").exists()


def test_pages_that_cannot_be_made(
    saved: dict[str, Path], monkeypatch, capsys, tmp_path: Path
) -> None:
    """Without Plotly the extra is named; a folder without a result has no page."""
    monkeypatch.setattr("planopt.report.page.find_spec", lambda name: None)
    assert main(["report", str(saved["plan"])]) == 2
    assert "pip install 'planopt[report]'" in capsys.readouterr().err
    assert main(["report", str(tmp_path)]) == 2
    assert not list(tmp_path.iterdir())
    assert capsys.readouterr().err.startswith("planopt: ")


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind != "run")) for kind in KINDS]
)
def test_in_a_browser(kind: str, saved: dict[str, Path], pages: dict[str, str]) -> None:
    """The page renders, the slider moves the robot by key, and the console stays empty."""
    with opened(saved[kind] / "report.html") as (page, messages):
        page.wait_for_function("document.querySelectorAll('.js-plotly-plot').length > 0")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        if kind not in ("comparison", "deployment"):
            where = "document.getElementById('map').data.filter(t => t.mode === 'markers')[0].x[0]"
            before = page.evaluate(where)
            page.focus("#step")
            page.keyboard.press("End")
            page.wait_for_function(f"{where} !== {before}")
            end = content_of(pages[kind])["map"]["groups"][0]["tracks"][0]["x"][-1]
            assert page.evaluate(where) == end
        assert messages == []
