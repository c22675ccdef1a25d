"""Text report and figure of planners' results in the regression suite."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planopt.report.panel import (
    FRAME,
    MARKERS,
    NOTE_PT,
    SERIES,
    WHITE,
    Panel,
    dashed_look,
    dress,
    head,
    legend_below,
    legend_inside,
    new_figure,
    plain_log_ticks,
)
from planopt.report.tables import MISSING, WIDTH, aligned
from planopt.studies.bench_cases import OBJECTIVE_SHARE, Manifest, Question, Row
from planopt.studies.bench_references import Score, excess, scores, time_profile

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_EXCESS = 1e-6
"""Smallest relative excess over the best known objective that is plotted."""

SHOWN = 20
"""Maximum number of cases of each kind listed in the text; the JSON file lists all."""


def bench_text(data: Mapping[str, Any]) -> str:
    """Return a report as plain text: scores, software, machine, and notable cases."""
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
    return "\n".join([*_stacked(header, lines), "", *wrapped, *([""] if found else []), *found])


def draw_bench(rows: Sequence[Row], best: Mapping[Question, float], manifest: Manifest) -> Figure:
    """Draw the results of planners in the regression suite.

    Four panels show the performance profile of times, the cumulative distribution of the relative
    excess over the best known objective, the rates, and the fallbacks that released plans.
    """
    figure, panels = new_figure(12.0, 9.0, ["AB", "CD"])
    each = scores(rows, best)
    planners = [score.planner for score in each]
    profile = time_profile(rows, best)
    for number, (planner, shares) in enumerate(zip(profile.planners, profile.shares, strict=True)):
        ratios = np.append(profile.ratios, 1.2 * profile.ratios[-1])
        _draw_steps(panels[0], ratios, np.append(shares, shares[-1]), planner, number)
    words = "time / fastest planner's time [1]", "cases solved [%]"
    dress(panels[0], "solved within a time", *words)
    panels[0].set_xlim(0.95, max(1.2 * float(profile.ratios[-1]), 2.0))
    for number, planner in enumerate(planners):
        mine = [excess(row, best) for row in rows if row.planner == planner]
        worse = np.sort([max(share, LEAST_EXCESS) for share in mine if share is not None])
        shares = np.arange(1, worse.size + 1) / max(len(mine), 1)
        _draw_steps(panels[1], 100.0 * worse, shares, planner, number)
    words = "worse than the best known by at most [%]", "cases [%]"
    dress(panels[1], "objective against the best known", *words)
    shares = [excess(row, best) or 0.0 for row in rows]
    panels[1].set_xlim(70.0 * LEAST_EXCESS, 150.0 * max([*shares, OBJECTIVE_SHARE]))
    panels[1].axvline(100.0 * OBJECTIVE_SHARE, color=FRAME, linewidth=1.0, linestyle=":")
    for panel in panels[:2]:
        panel.set_xscale("log")
        panel.set_ylim(0.0, 103.0)
    plain_log_ticks(panels[0].xaxis)
    _draw_rates(panels[2], each)
    _draw_fallbacks(panels[3], rows, planners)
    legend_below(figure, panels[0].get_legend_handles_labels()[0], 7)
    head(figure, f"{len(rows)} cases; {manifest.made_by}; {manifest.cpu}")
    return figure


def _draw_steps(
    panel: Panel, x: NDArray[np.float64], shares: NDArray[np.float64], planner: str, number: int
) -> None:
    """Draw a planner's cumulative share of cases (n,) as a step curve over x (n,)."""
    look = {"drawstyle": "steps-post", "label": planner, **dashed_look(number)}
    panel.plot(x, 100.0 * shares, **look)


def _draw_rates(panel: Panel, each: Sequence[Score]) -> None:
    """Draw the shares of solved cases, verified cases and correct claims, by planner."""
    places = np.arange(len(each), dtype=np.float64)
    rates = np.array(
        [(one.success_rate, one.verified_rate, one.correct_rate) for one in each], dtype=np.float64
    )
    labels = "solved", "verified", "claims that hold"
    for number, (label, values) in enumerate(zip(labels, rates.T, strict=True)):
        look = {"linestyle": "none", "marker": MARKERS[number], "color": SERIES[-1 - number]}
        edge = {"markersize": 8.0, "markeredgecolor": FRAME, "clip_on": False}
        panel.plot(places + 0.2 * (number - 1), 100.0 * values, label=label, **look, **edge)
    dress(panel, "rates", "planner", "share [%]")
    panel.set_xticks(places, labels=[score.planner for score in each])
    panel.set_xlim(-0.5, len(each) - 0.5)
    panel.set_ylim(0.0, 103.0)
    legend_inside(panel, "lower left")


def _draw_fallbacks(panel: Panel, rows: Sequence[Row], planners: Sequence[str]) -> None:
    """Draw the fallbacks that released the plans of each planner, as stacked shares."""
    names = list(dict.fromkeys(name for row in rows for name in row.rungs))
    counts = np.zeros((len(names), len(planners)))
    for row in rows:
        for name, count in row.rungs.items():
            counts[names.index(name), planners.index(row.planner)] += count
    shares = 100.0 * counts / np.maximum(counts.sum(axis=0), 1.0)
    places = np.arange(len(planners), dtype=np.float64)
    for number, (name, share) in enumerate(zip(names, shares, strict=True)):
        hatch = "" if number < len(SERIES) else "//"
        look = {"color": SERIES[number % len(SERIES)], "edgecolor": WHITE, "hatch": hatch}
        below = shares[:number].sum(axis=0)
        panel.bar(places, share, bottom=below, width=0.7, label=name, **look)
    dress(panel, "fallbacks", "planner", "released plans [%]")
    panel.set_xticks(places, labels=list(planners))
    panel.set_ylim(0.0, 130.0)
    panel.set_yticks([0.0, 25.0, 50.0, 75.0, 100.0])
    panel.legend(fontsize=NOTE_PT, loc="upper left", ncols=4, frameon=False)


def _percent(share: float | None, digits: int = 1) -> str:
    return MISSING if share is None else f"{100.0 * share:.{digits}f}"


def _stacked(header: Sequence[str], lines: Sequence[Sequence[str]]) -> list[str]:
    """Return a table whose headings are split into one word per line."""
    words = [heading.split() for heading in header]
    height = max(map(len, words))
    above = [[*[""] * (height - len(each)), *each] for each in words]
    return aligned([*zip(*above, strict=True), *lines], 1)
