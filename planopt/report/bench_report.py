"""Results of planners in the regression suite, as an HTML page and as Markdown."""

from collections.abc import Mapping, Sequence

import numpy as np

from planopt.arrays import Floats
from planopt.problems.library import Classification, classifications
from planopt.report.page import MOST_ROWS, Chart, Page, PageTable, Trace, cell_text, plain, scatter
from planopt.report.panel import colour_of
from planopt.report.tables import MISSING
from planopt.studies.bench_cases import OBJECTIVE_SHARE, PLAN, RUN, Manifest, Question, Row
from planopt.studies.bench_references import (
    LIMIT_S,
    SHIFT_S,
    References,
    Score,
    best_known,
    bounds_known,
    excess,
    gap_to_bound,
    is_solved,
    scores,
    time_profile,
)

LEAST_EXCESS = 1e-6  # Smallest relative excess over the best known or the bound that is plotted

KINDS = {PLAN: "plans from the start (cold starts)", RUN: "closed loops (warm starts)"}

DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")

SCORE_HEAD = (
    *("planner", "cases", "solved [%]", "correct [%]", "verified [%]", "rejected", "errors"),
    *("fallback [%]", "median excess [%]", "largest excess [%]", "proven bounds", "median gap [%]"),
    *("largest gap [%]", "iterations", "mean time [s]", "median time [s]", "deadlines met"),
)

QUESTION_HEAD = (
    *("problem", "family", "difficulty", "kind", "horizon", "seed", "planners", "solved by"),
    *("best known", "bound", "gap [%]", "smoothed gap [%]", "verdicts", "provenance"),
)

LEGEND = (
    f"solved: verified, accepted by the check, objective within {100.0 * OBJECTIVE_SHARE:.0f} % "
    "of the best known; or no plan where none is known",
    "correct: share of the planner's claims (verified, converged, no plan) that the suite confirms",
    "fallback: share of plans released by a fallback, after the planner's own path failed",
    "excess: relative distance of the objective from the best known",
    "gap: relative distance of the objective from the proven bound; smoothed gap: the same of the "
    "cost of plan and route after the improvement by the bound, with outage integrated",
    f"time: processor time per plan; mean: geometric, shifted by {SHIFT_S:g} s, unsolved cases "
    f"count as {LIMIT_S:g} s; median: solved cases only",
    "deadlines met: plans within planner.budget_s, or within a step without a budget, by wall time",
)

LIMITATIONS = (
    "The best known objective is that of the best row or reference; only a bound says how far from "
    "optimal it may be.",
    "Bounds of routes drop moving obstacles, inertia and the separation of robots; bounds of teams "
    "that keep apart hold given the other robots' plans. Objectives without a bound have none.",
    "Verdicts are about the model of each problem; whether its channel is right is not tested.",
    "Closed loops of robots stop after 20 steps.",
    "The cost-to-go of robots with inertia begins at rest after braking; it may miss the bound.",
    "Times are comparable within one run only; other processes of the machine delay deadlines.",
)


def bench_page(rows: Sequence[Row], known: References, manifest: Manifest) -> Page:
    """Return the page of a suite run, with charts and with scores by kind, family and question."""
    best, bounds = best_known(known, rows), bounds_known(known, rows)
    kinds = {kind: [row for row in rows if row.kind == kind] for kind in KINDS}
    kinds = {kind: own for kind, own in kinds.items() if own}
    program = ", ".join(f"{name} {version[:12]}" for name, version in manifest.program.items())
    tolerances = ", ".join(f"{name} {value:g}" for name, value in manifest.tolerances.items())
    questions = dict.fromkeys(row.question for row in rows)
    tests = classifications()
    words = (
        f"{len(rows)} cases: {len(questions)} questions (problem, horizon, seed) about "
        f"{len(manifest.problems)} problems, each for several planners; "
        f"{sum(row.case in known for row in rows)} cases have a reference",
        *LEGEND,
        f"made by {program}; Python {manifest.python}; {manifest.cpu}, {manifest.cores} cores",
        f"tolerances: {tolerances}",
        *(f"limitation: {words}" for words in LIMITATIONS),
    )
    listed = [_question_cells(each, rows, tests, best, bounds) for each in questions]
    rates: list[Chart] = []
    for kind, own in kinds.items():
        each = scores(own, best)
        names = (
            ("solved", "success_rate"),
            ("verified", "verified_rate"),
            ("correct", "correct_rate"),
        )
        values = {label: [getattr(score, name) for score in each] for label, name in names}
        planners = [score.planner for score in each]
        rates.append(_bars(f"Rates, {KINDS[kind]}", planners, values, "group"))
    return Page(
        title="Planners in the regression suite",
        description=f"{manifest.made_by}, on {manifest.cpu}",
        words=words,
        charts=[
            *(_profile_chart(own, best, KINDS[kind]) for kind, own in kinds.items()),
            _excess_chart(rows, best),
            _gap_chart(rows, tests),
            *rates,
            _fallback_chart(rows),
        ],
        tables=[
            *(
                PageTable(
                    f"Scores, {KINDS[kind]}", SCORE_HEAD, list(map(_cells, scores(own, best)))
                )
                for kind, own in kinds.items()
            ),
            _family_table(rows, tests, best),
            PageTable("Questions", QUESTION_HEAD, listed[:MOST_ROWS], len(listed), "rows.csv"),
        ],
    )


def page_markdown(page: Page, *, whole: bool = True) -> str:
    """Return a page's title, tables and notes as Markdown; omit details unless `whole`."""
    parts = [f"# {page.title}", page.description]
    for table in page.tables if whole else page.tables[:-1]:
        lines = [table.header, *table.rows]
        cells = [[cell_text(value).replace("|", "\\|") for value in line] for line in lines]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        text = ["| " + " | ".join(map(str.ljust, line, widths)) + " |" for line in cells]
        text.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
        parts += [f"## {table.title}", "\n".join(text)]
    details = () if whole else ("made by", "tolerances", "limitation")
    notes = [f"- {line}" for line in page.words if not line.startswith(tuple(details))]
    return "\n\n".join([*parts, "## Notes", "\n".join(notes)]) + "\n"


def _cells(score: Score) -> list[object]:
    """Return the cells of a planner in the table of scores."""
    timed = f"{score.plans - score.late} of {score.plans}" if score.plans else MISSING
    return [
        *(score.planner, score.cases, _percent(score.success_rate), _percent(score.correct_rate)),
        *(_percent(score.verified_rate), score.rejected, score.errors),
        *(_percent(score.fallback_share), _percent(score.median_excess, 3)),
        *(_percent(score.largest_excess, 3), score.bounds, _percent(score.median_gap, 2)),
        *(_percent(score.largest_gap, 2), f"{score.iterations:.1f}", f"{score.mean_s:.3f}"),
        *(MISSING if score.median_s is None else f"{score.median_s:.3f}", timed),
    ]


def _family_table(
    rows: Sequence[Row], tests: Mapping[str, Classification], best: Mapping[Question, float]
) -> PageTable:
    """Return the share of solved cases by family and planner."""
    planners = list(dict.fromkeys(row.planner for row in rows))
    families: dict[str, list[Row]] = {}
    for row in rows:
        families.setdefault(tests[row.problem].family or "other", []).append(row)
    lines: list[list[object]] = []
    for family, own in families.items():
        cells: list[object] = [family, len({row.problem for row in own})]
        for planner in planners:
            solved = [is_solved(row, best) for row in own if row.planner == planner]
            cells.append(f"{sum(solved)} of {len(solved)}" if solved else MISSING)
        lines.append(cells)
    return PageTable("Solved cases by family", ("family", "problems", *planners), lines)


def _question_cells(
    question: Question,
    rows: Sequence[Row],
    tests: Mapping[str, Classification],
    best: Mapping[Question, float],
    bounds: Mapping[Question, float],
) -> list[object]:
    own = [row for row in rows if row.question == question]
    test = tests[question.problem]
    solvers = [row.planner for row in own if is_solved(row, best)]
    gaps = [gap for gap in map(gap_to_bound, own) if gap is not None]
    smoothed = [row.gap for row in own if row.gap is not None]
    cost = f", {question.cost_to_go}" if question.cost_to_go else ""
    return [
        *(question.problem, test.family, test.difficulty, f"{question.kind}{cost}"),
        *(question.horizon, question.seed, len(own), ", ".join(solvers) or "none"),
        *(best.get(question), bounds.get(question), _percent(min(gaps, default=None), 2)),
        _percent(min(smoothed, default=None), 2),
        *(", ".join(dict.fromkeys(row.verdict for row in own)), test.provenance),
    ]


def _profile_chart(rows: Sequence[Row], best: Mapping[Question, float], kind: str) -> Chart:
    """Return the performance profile of times: shares solved within a multiple of the fastest."""
    profile = time_profile(rows, best)
    ratios = np.append(profile.ratios, 1.2 * profile.ratios[-1])
    lines = [
        _steps(number, planner, ratios, np.append(shares, shares[-1]))
        for number, (planner, shares) in enumerate(
            zip(profile.planners, profile.shares, strict=True)
        )
    ]
    title = f"Performance profile, {kind}"
    return Chart(title, lines, "time / fastest planner's time [1]", "solved [%]", layout=LOG_X)


def _excess_chart(rows: Sequence[Row], best: Mapping[Question, float]) -> Chart:
    """Return the cumulative distribution of the relative excess over the best known objective."""
    lines: list[Trace] = []
    for number, planner in enumerate(dict.fromkeys(row.planner for row in rows)):
        mine = [excess(row, best) for row in rows if row.planner == planner]
        worse = np.sort([max(share, LEAST_EXCESS) for share in mine if share is not None])
        shares = np.arange(1, worse.size + 1) / max(len(mine), 1)
        lines.append(_steps(number, planner, 100.0 * worse, shares))
    x = "worse than the best known by at most [%]"
    return Chart("Objective against the best known", lines, x, "cases [%]", layout=LOG_X)


def _gap_chart(rows: Sequence[Row], tests: Mapping[str, Classification]) -> Chart:
    """Return a chart of gaps to proven bounds by problem; problems are ordered by family."""
    planners = list(dict.fromkeys(row.planner for row in rows))
    points: list[Trace] = []
    for number, planner in enumerate(planners):
        mine = [(row, gap_to_bound(row)) for row in rows if row.planner == planner]
        mine = [(row.problem, gap) for row, gap in mine if gap is not None]
        mine.sort(key=lambda point: (tests[point[0]].family, point[0]))
        look = {"color": colour_of(number), "symbol": number, "size": 8}
        problems = [plain(problem) for problem, _ in mine]
        gaps = [100.0 * max(gap, LEAST_EXCESS) for _, gap in mine]
        points.append(scatter(planner, problems, gaps, marker=look))
    points = [each for each in points if each["x"]]
    layout = {"yaxis": {"type": "log", "tickformat": "~g"}}
    return Chart("Gap to the proven bound", points, "problem", "gap [%]", layout=layout)


def _fallback_chart(rows: Sequence[Row]) -> Chart:
    """Return a stacked bar chart of the share of each planner's plans by fallback."""
    planners = list(dict.fromkeys(row.planner for row in rows))
    counts: dict[str, dict[str, int]] = {planner: {} for planner in planners}
    for row in rows:
        for name, count in row.rungs.items():
            counts[row.planner][name] = counts[row.planner].get(name, 0) + count
    totals = {planner: max(sum(own.values()), 1) for planner, own in counts.items()}
    values = {
        name: [counts[planner].get(name, 0) / totals[planner] for planner in planners]
        for name in dict.fromkeys(name for own in counts.values() for name in own)
    }
    return _bars("Fallbacks that released the plans", planners, values, "stack")


def _bars(
    title: str, planners: Sequence[str], values: Mapping[str, Sequence[float | None]], mode: str
) -> Chart:
    """Return a bar chart of shares by planner, one series per name."""
    bars = [
        {
            "type": "bar",
            "name": plain(name),
            "x": [plain(planner) for planner in planners],
            "y": [None if share is None else 100.0 * share for share in shares],
            "marker": {"color": colour_of(number), "pattern": {"shape": "/" if number > 5 else ""}},
        }
        for number, (name, shares) in enumerate(values.items())
    ]
    layout = {"barmode": mode, "yaxis": {"range": [0.0, 103.0]}, "xaxis": {"automargin": True}}
    return Chart(title, bars, "planner", "share [%]", layout=layout)


LOG_X = {"xaxis": {"type": "log", "tickformat": "~g"}, "yaxis": {"range": [0.0, 103.0]}}


def _steps(number: int, planner: str, x: Floats, shares: Floats) -> Trace:
    """Return a planner's cumulative share of cases (n,) as a step curve over x (n,)."""
    line = {"shape": "hv", "color": colour_of(number), "dash": DASHES[number % len(DASHES)]}
    look = {"line": line, "marker": {"size": 4}}
    return scatter(planner, x.tolist(), (100.0 * shares).tolist(), "lines+markers", **look)


def _percent(share: float | None, digits: int = 1) -> str:
    return MISSING if share is None else f"{100.0 * share:.{digits}f}"
