"""The results of planners in the regression suite, as text and as a figure."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import MARKERS, SERIES, dress, head, legend_below, plain_log_ticks
from planopt.report.tables import MISSING, WIDTH, aligned
from planopt.studies.bench.cases import Question
from planopt.studies.bench.folder import Manifest
from planopt.studies.bench.references import OBJECTIVE_SHARE
from planopt.studies.bench.row import Row
from planopt.studies.bench.scores import Score, excess, scores, time_profile

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

LEAST_EXCESS = 1e-6
"""Objectives nearer than this share to the best known are drawn as if they were this far."""

LINES = ("-", "--", "-.", ":")
"""Planners are told apart by these as well as by colour."""

SHOWN = 20
"""Regressions and rejections that the text lists; the JSON file has all."""


def bench_text(data: Mapping[str, Any]) -> str:
    """Return a report as plain text: scores, regressions, and what made the numbers."""
    header = [
        *("planner", "cases", "solved [%]", "correct [%]", "verified [%]", "rejected", "errors"),
        *("fallback [%]", "median excess [%]", "largest excess [%]", "iterations", "mean [s]"),
    ]
    lines = [
        [
            score["planner"],
            str(score["cases"]),
            _percent(score["success_rate"]),
            _percent(score["correct_rate"]),
            _percent(score["verified_rate"]),
            str(score["rejected"]),
            str(score["errors"]),
            _percent(score["fallback_share"]),
            _percent(score["median_excess"], 3),
            _percent(score["largest_excess"], 3),
            f"{score['iterations']:.1f}",
            f"{score['mean_s']:.3f}",
        ]
        for score in data["planners"]
    ]
    table = [
        # Headings of several words stand below each other.
        *_stacked(header, lines),
    ]
    program = ", ".join(f"{name} {version[:12]}" for name, version in data["program"].items())
    tolerances = ", ".join(f"{name} {value:g}" for name, value in data["tolerances"].items())
    notes = (
        f"{data['rows']} cases of {data['questions']} questions, {data['with_reference']} of them "
        "with a reference",
        "solved: verified, not rejected by the check, objective within "
        f"{OBJECTIVE_SHARE:.0%} of the best known; correct: share of the claims that hold; excess: "
        "how much worse than the best known; mean: shifted geometric mean of the processor time a "
        f"plan, {data['time_shift_s']:g} s shift, unsolved cases as {data['time_limit_s']:g} s",
        f"{program}; Python {data['python']}; {data['cpu']}, {data['cores']} cores",
        f"tolerances: {tolerances}",
    )
    found = [
        f"{kind}: {words}"
        for key, kind in (
            ("regressions", "worse"),
            ("improvements", "better"),
            ("rejected", "rejected"),
        )
        for words in data[key][:SHOWN]
    ]
    wrapped = [line for note in notes for line in textwrap.wrap(note, WIDTH)]
    return "\n".join([*table, "", *wrapped, *([""] if found else []), *found])


def draw_bench(rows: Sequence[Row], best: Mapping[Question, float], manifest: Manifest) -> Figure:
    """Draw how planners did.

    Four panels: the performance profile of times, the share of cases by how much worse their
    objective is than the best known, the rates, and the fallbacks that released plans.
    """
    from matplotlib.gridspec import GridSpec

    figure = new_figure(12.0, 9.0)
    cells = GridSpec(2, 2, figure=figure)
    panels = [add_panel(figure, cells[number // 2, number % 2]) for number in range(4)]
    each = scores(rows, best)
    entries = _draw_profile(panels[0], rows, best)
    _draw_excess(panels[1], rows, best, [score.planner for score in each])
    _draw_rates(panels[2], each)
    _draw_fallbacks(panels[3], rows, [score.planner for score in each])
    legend_below(figure, entries, 7)
    head(figure, f"{len(rows)} cases; {manifest.made_by}; {manifest.cpu}")
    return figure


def _draw_profile(
    panel: Panel, rows: Sequence[Row], best: Mapping[Question, float]
) -> list[Artist]:
    """Draw which share of its cases each planner solves within a ratio of the fastest time."""
    profile = time_profile(rows, best)
    entries: list[Artist] = []
    for number, (planner, shares) in enumerate(zip(profile.planners, profile.shares, strict=True)):
        entries += panel.plot(
            np.append(profile.ratios, 1.2 * profile.ratios[-1]),
            100.0 * np.append(shares, shares[-1]),
            drawstyle="steps-post",
            label=planner,
            **_line(number),
        )
    dress(panel, "solved within a time", "time / fastest planner's", "cases solved [%]")
    panel.set_xlim(0.95, max(1.2 * float(profile.ratios[-1]), 2.0))
    panel.set_xscale("log")
    plain_log_ticks(panel.xaxis)
    panel.set_ylim(0.0, 103.0)
    return entries


def _draw_excess(
    panel: Panel,
    rows: Sequence[Row],
    best: Mapping[Question, float],
    planners: Sequence[str],
) -> None:
    """Draw the share of cases whose objective is at most so much worse than the best known."""
    for number, planner in enumerate(planners):
        mine = [excess(row, best) for row in rows if row.planner == planner]
        worse = np.sort([max(share, LEAST_EXCESS) for share in mine if share is not None])
        if worse.size:
            share = 100.0 * np.arange(1, worse.size + 1) / len(mine)
            panel.plot(100.0 * worse, share, drawstyle="steps-post", **_line(number))
    dress(
        panel,
        "objective against the best known",
        "worse than the best known by at most [%]",
        "cases [%]",
    )
    shares = [excess(row, best) or 0.0 for row in rows]
    panel.set_xlim(70.0 * LEAST_EXCESS, 150.0 * max([*shares, OBJECTIVE_SHARE]))
    panel.set_xscale("log")
    panel.plot(
        [100.0 * OBJECTIVE_SHARE] * 2, [0.0, 103.0], color="#404040", linewidth=1.0, linestyle=":"
    )
    panel.set_ylim(0.0, 103.0)


def _draw_rates(panel: Panel, each: Sequence[Score]) -> None:
    """Draw the shares solved, verified, and of claims that hold, by planner."""
    places = np.arange(len(each), dtype=float)
    for number, (label, values) in enumerate(
        (
            ("solved", [score.success_rate for score in each]),
            ("verified", [score.verified_rate for score in each]),
            ("claims that hold", [score.correct_rate for score in each]),
        )
    ):
        both = zip(places, values, strict=True)
        known = [(x, 100.0 * value) for x, value in both if value is not None]
        panel.plot(
            [x + 0.2 * (number - 1) for x, _ in known],
            [value for _, value in known],
            linestyle="none",
            marker=MARKERS[number],
            markersize=8.0,
            color=SERIES[-1 - number],
            markeredgecolor="#404040",
            label=label,
            clip_on=False,
        )
    dress(panel, "rates", "planner", "share [%]")
    panel.set_xticks(places, labels=[score.planner for score in each])
    panel.set_xlim(-0.5, len(each) - 0.5)
    panel.set_ylim(0.0, 103.0)
    panel.legend(fontsize=9.0, loc="lower left", framealpha=0.9, edgecolor="none")


def _draw_fallbacks(panel: Panel, rows: Sequence[Row], planners: Sequence[str]) -> None:
    """Draw which fallbacks released the plans of each planner, as stacked shares."""
    counts = [
        {
            name: sum(row.rungs.get(name, 0) for row in rows if row.planner == planner)
            for name in dict.fromkeys(name for row in rows for name in row.rungs)
        }
        for planner in planners
    ]
    places = np.arange(len(planners), dtype=float)
    below = np.zeros(len(planners))
    for number, name in enumerate(counts[0]):
        share = np.array([100.0 * one[name] / max(sum(one.values()), 1) for one in counts])
        panel.bar(
            places,
            share,
            bottom=below,
            width=0.7,
            color=SERIES[number % len(SERIES)],
            edgecolor="white",
            hatch="" if number < len(SERIES) else "//",
            label=name,
        )
        below += share
    dress(panel, "fallbacks", "planner", "released plans [%]")
    panel.set_xticks(places, labels=list(planners))
    panel.set_ylim(0.0, 130.0)
    panel.set_yticks([0.0, 25.0, 50.0, 75.0, 100.0])
    panel.legend(fontsize=9.0, loc="upper left", ncols=4, frameon=False)


def _line(number: int) -> dict[str, object]:
    return {
        "color": SERIES[number % len(SERIES)],
        "linestyle": LINES[number % len(LINES)],
        "linewidth": 1.8,
    }


def _percent(share: float | None, digits: int = 1) -> str:
    return MISSING if share is None else f"{100.0 * share:.{digits}f}"


def _stacked(header: Sequence[str], lines: Sequence[Sequence[str]]) -> list[str]:
    """Return a table whose headings stand one word below the other."""
    words = [heading.split() for heading in header]
    height = max(map(len, words))
    above = [[*[""] * (height - len(each)), *each] for each in words]
    return aligned([*zip(*above, strict=True), *lines], 1)
