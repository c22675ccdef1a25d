"""Comparisons as plain-text tables: means, paired differences, and how predictions came true."""

from __future__ import annotations

import textwrap
from collections.abc import Hashable, Sequence

from planopt.report.tables import (
    BAND_ENDS,
    BANDS,
    MISSING,
    WIDTH,
    aligned,
    interval_words,
    metric_name,
    reliability_lines,
)
from planopt.studies.comparison import Comparison
from planopt.studies.comparison_rows import (
    Row,
    has_horizon,
    setting_of,
    setting_words,
    short_keys,
)

OWN = "own"
"""Value of a swept key that a setting leaves as it is in the problem."""

SETTING_WIDTH = 80
"""Letters of a setting in words, where settings are numbered."""

VERIFIED, POLISH = ("verified [%]", ""), ("polish gain [%]", "polish_gain")
"""Columns of every task; the first is of no metric."""

GOAL_COLUMNS = (
    ("time to goal [s]", "goal_time_s"),
    ("connected [%]", "true_connected_share"),
    ("longest outage [m]", "longest_outage_m"),
    ("realised cost [m]", "realised_cost_m"),
    ("cost ratio", "cost_ratio"),
    ("least P", "predicted_min_connectivity"),
    VERIFIED,
    POLISH,
)
"""Metrics shown where there is a goal, and their headings; the first with its interval."""


Setting = dict[str, Row]
"""The rows of one setting by metric."""


def comparison_text(comparison: Comparison) -> str:
    """Table of a comparison, aligned, one line a setting in the order of the rows.

    What does not fit `WIDTH` letters goes below, with what names the setting before it again. With
    several swept keys settings are numbered, and said in words once.

    Parameters
    ----------
    comparison
        The comparison. A metric that a setting does not have is shown as ``-``; where there is no
        goal, one that no setting has is left out.
    """
    found: dict[Hashable, Setting] = {}
    for row in comparison.rows:
        found.setdefault(setting_of(row), {})[row.metric] = row
    settings = list(found.values())
    problems = (comparison.problem, *comparison.others)
    to_goal = all(problem.task == "reach" for problem in problems)
    shown = GOAL_COLUMNS if to_goal else _columns(comparison.rows)
    title = (
        f"{', '.join(problem.name for problem in problems)}: {len(comparison.runs)} runs in "
        f"{comparison.wall_s:.1f} s; means over runs, {interval_words(comparison)}"
    )
    if comparison.resumed:
        title += f"; {comparison.resumed} runs were finished before"
    if to_goal:
        title += "; time to goal and cost ratio (to the clairvoyant) over the runs that arrived"
    header, *lines = _names(comparison, settings, to_goal=to_goal)
    words = len(header) - 1
    listed: list[str] = []
    if len(short_keys(comparison.rows)) > 1:
        listed = [*_listed(comparison, settings), ""]
    metrics = [name for _, name in shown]
    headings = ["runs", "stalled", *(heading for heading, _ in shown)]
    table = [[*header, *headings, "step p50 [ms]", "step p95 [ms]"]]
    for names, rows in zip(lines, settings, strict=True):
        table.append([*names, *_cells(rows, metrics)])
    text = [*textwrap.wrap(title, WIDTH), "", *listed, *_in_blocks(table, words)]
    text += ["", *_paired(settings, [header, *lines], [name for name in metrics if name])]
    text += reliability_lines(comparison.reliability, "steps", "seeds")
    return "\n".join(text).rstrip("\n")


def _names(
    comparison: Comparison, settings: Sequence[Setting], *, to_goal: bool
) -> list[list[str]]:
    """Headings and cells that name the settings, the last of each to the right."""
    swept = list(short_keys(comparison.rows))
    if len(swept) > 1:
        return [["setting"], *([str(number + 1)] for number in range(len(settings)))]
    several = bool(comparison.others)
    header = [*(["problem"] if several else []), *swept, *(["cost to go"] if to_goal else [])]
    lines = [[*header, "planner", "horizon"]]
    for rows in settings:
        one = next(iter(rows.values()))
        lines.append(
            [
                *([one.problem] if several else []),
                *(str(one.sweep.get(key, OWN)) for key in swept),
                *([str(one.cost_to_go)] if to_goal else []),
                one.planner,
                str(one.horizon) if has_horizon(one) else MISSING,
            ]
        )
    return lines


def _listed(comparison: Comparison, settings: Sequence[Setting]) -> list[str]:
    """Settings with their numbers, in words."""
    names = short_keys(comparison.rows)
    lines = ["settings"]
    for number, rows in enumerate(settings, start=1):
        one = next(iter(rows.values()))
        words = textwrap.wrap(
            setting_words(one, names, several_problems=bool(comparison.others)), SETTING_WIDTH
        )
        before = [f"{number:>7}  ", *[" " * 9] * len(words)]
        lines += [f"{space}{part}" for space, part in zip(before, words, strict=False)]
    long = [f"{short} is {key}" for key, short in names.items() if short != key]
    return [*lines, *textwrap.wrap(", ".join(long), WIDTH)]


def _paired(
    settings: Sequence[Setting], names: Sequence[Sequence[str]], metrics: Sequence[str]
) -> list[str]:
    """Table of differences from the first setting, seed by seed, with their intervals.

    Those whose interval leaves out zero have a star. No line where there is no interval.
    """
    known = [m for m in metrics if any(_difference(rows.get(m)) != MISSING for rows in settings)]
    if not known:
        return []
    shown = [m for m in known if any(_differs(rows.get(m)) for rows in settings[1:])]
    same = [metric_name(metric).words for metric in known if metric not in shown]
    cells = [[_difference(rows.get(metric)) for metric in shown] for rows in settings[1:]]
    intervals = [cell for line in cells for cell in line if cell != MISSING]
    apart = sum(cell.endswith("*") for cell in intervals)
    title = (
        "paired differences from the first setting, seed by seed, with 95 % intervals; "
        f"{apart} of {len(intervals)} leave out zero (*)"
    )
    headings = [f"{metric_name(m).words} [{metric_name(m).unit}]" for m in shown]
    table = [[*names[0], *headings]]
    table += [[*name, *line] for name, line in zip(names[2:], cells, strict=True)]
    alike = textwrap.wrap(f"the same in every run: {', '.join(same)}", WIDTH) if same else []
    return [*textwrap.wrap(title, WIDTH), *_in_blocks(table, len(names[0]) - 1), *alike, ""]


def _differs(row: Row | None) -> bool:
    """Return whether a metric differs from the first setting's on any seed."""
    return row is not None and any((row.paired_difference, row.difference_low, row.difference_high))


def _difference(row: Row | None) -> str:
    """The paired difference with its interval, and a star where that leaves out zero."""
    if row is None or row.paired_difference is None:
        return MISSING
    low, high, name = row.difference_low, row.difference_high, metric_name(row.metric)
    if low is None or high is None:
        return MISSING
    mean, begin, end = (
        f"{name.scale * value:+.{name.digits}f}" for value in (row.paired_difference, low, high)
    )
    return f"{mean} ({begin} to {end})" + ("" if low <= 0.0 <= high else " *")


def _columns(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Heading and name of every metric of a sum of terms that a setting has."""
    there = dict.fromkeys(row.metric for row in rows if row.mean is not None)
    metrics = [m for m in there if m != "polish_gain" and m not in BAND_ENDS]
    return [*((_heading(m), m) for m in metrics), VERIFIED, POLISH]


def _heading(metric: str) -> str:
    name = metric_name(metric)
    band = f", and of {BANDS[metric][-1]}" if metric in BANDS else ""
    return f"{name.words} [{name.unit}]{band}"


def _cells(rows: Setting, shown: Sequence[str]) -> list[str]:
    """The numbers of a line; what is not of one metric is the same in every row."""
    one = next(iter(rows.values()))
    return [
        str(one.seeds),
        str(one.stalled),
        *(
            _mean(rows, metric, interval=metric == shown[0])
            if metric
            else (MISSING if one.verified_rate is None else f"{100.0 * one.verified_rate:.1f}")
            for metric in shown
        ),
        *(
            MISSING if seconds is None else f"{1e3 * seconds:.1f}"
            for seconds in (one.p50_step_s, one.p95_step_s)
        ),
    ]


def _mean(rows: Setting, metric: str, *, interval: bool = False) -> str:
    """Mean of a metric in the unit shown, with its interval if asked for, and its band."""
    row, name = rows.get(metric), metric_name(metric)
    if row is None or row.mean is None:
        return MISSING
    text = f"{name.scale * row.mean:.{name.digits}f}"
    if interval and row.ci_low is not None and row.ci_high is not None:
        low, high = name.scale * row.ci_low, name.scale * row.ci_high
        text += f" ({low:.{name.digits}f} to {high:.{name.digits}f})"
    ends = [rows[end].mean for end in BANDS.get(metric, ())[:2] if end in rows]
    if ends:
        text += ", " + " to ".join(f"{name.scale * (end or 0.0):.{name.digits}f}" for end in ends)
    return text


def _in_blocks(table: Sequence[Sequence[str]], words: int) -> list[str]:
    """Return aligned lines, headings over several where they are wider than what is below them.

    Blocks of columns of at most `WIDTH` letters stand below each other, an empty line between
    them; each begins with the first `words` columns and the one after, which name the line.
    """
    columns = [
        [textwrap.wrap(heading, max(map(len, (*heading.split(), *below)))), below]
        for heading, *below in zip(*table, strict=True)
    ]
    widths = [2 + max(map(len, (*heading, *below))) for heading, below in columns]
    first = words + 1
    blocks, room = [columns[:first]], WIDTH + 2 - sum(widths[:first])
    for column, width in zip(columns[first:], widths[first:], strict=True):
        if width > room and len(blocks[-1]) > first:
            blocks.append(columns[:first])
            room = WIDTH + 2 - sum(widths[:first])
        blocks[-1].append(column)
        room -= width
    lines: list[str] = []
    for block in blocks:
        height = max(len(heading) for heading, _ in block)
        padded = [[*[""] * (height - len(heading)), *heading, *below] for heading, below in block]
        lines += ["", *aligned(list(zip(*padded, strict=True)), words)]
    return lines[1:]
