"""Content of HTML pages and notebooks: plans, runs, results of other tasks, comparisons, fits."""

from __future__ import annotations

import io
import json
from base64 import b64encode
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from itertools import islice
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from planopt.arrays import Floats
from planopt.channel.parameters import PARAMETER_WORDS
from planopt.channel.posterior import Belief
from planopt.files.tables import Column, Data
from planopt.planning.files.run_tables import tables_of
from planopt.planning.loop.log import StepLog
from planopt.planning.loop.results import Run, Solution
from planopt.planning.plan import Plan, Verdict
from planopt.problems.load import problem_to_dict
from planopt.problems.problem import Problem, problem_of_robot
from planopt.problems.tasks import Result, task_of
from planopt.report.channel_figures import draw_fit, draw_posterior_map
from planopt.report.maps import believed_rasters, map_window
from planopt.report.motion_words import MEANING, planned_in_words, proof_in_words
from planopt.report.page import (
    METRE_DIGITS,
    MOST_ROWS,
    POWER_DIGITS,
    PROBABILITY_DIGITS,
    SYMBOLS,
    Chart,
    Layer,
    Page,
    PageMap,
    PageTable,
    Trace,
    Track,
    cell_text,
    plain,
    rounded,
    scatter,
)
from planopt.report.panel import (
    BAND_WORDS,
    BAND_Z,
    BLACK,
    DPI,
    GREEN,
    ORANGE,
    TIME,
    VERMILLION,
    YELLOW,
    colour_of,
)
from planopt.report.tables import comparison_text, figures_in_words, metric_label, metric_name
from planopt.short_repr import shown_number
from planopt.studies.comparison import Comparison, run_columns, setting_words
from planopt.studies.study import program

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from planopt.channel.channel_map import PosteriorMap
    from planopt.channel.estimation.channel_fit import ChannelFit


def motion_page(result: Solution | Run) -> Page:
    """Return the page of a motion plan or run."""
    problem, run = result.problem, result if isinstance(result, Run) else None
    plans = result.plans if isinstance(result, Solution) else ()
    belief = result.belief if isinstance(result, Solution) else result.beliefs[0]
    tracks = [_planned(plan) for plan in plans] if run is None else list(_driven(run))
    certificate = [
        line
        for number, plan in enumerate(plans)
        for line in (f"{plan.robot}:", *proof_in_words(problem_of_robot(problem, number), plan))
    ]
    known = [
        _figures(key_figures(result)),
        *_result_tables(tables_of(result)),
        *_settings(problem_to_dict(problem), result.seed),
    ]
    return Page(
        title=f"{'Plan' if run is None else 'Run'} of {problem.name}",
        description=problem.description,
        words=result.words,
        certificate=certificate if run is None else _run_certificates(run),
        map=_motion_map(problem, belief, tracks),
        charts=_planned_charts(problem, plans) if run is None else _run_charts(run),
        tables=known,
    )


def task_page(result: Result) -> Page:
    """Return the page of a result; its map shows the paths in the JSON object."""
    problem, contents = result.problem, result.task.contents(result)
    data: Mapping[str, Any] = contents.data
    tables: Mapping[str, tuple[Sequence[Column], Data]] = contents.tables
    tracks = [
        Track(
            str(robot["name"]),
            np.array(robot["t_s"], dtype=np.float64),
            np.column_stack([robot["x_m"], robot["y_m"]]),
            str(robot.get("role", "robot")),
        )
        for robot in data.get("robots", ())
    ]
    if tracks:
        tracks += [track for _, table in tables.values() for track in _events(table)]
    faults = data.get("faults")
    certificate = () if faults is None else (*map(str, faults),)
    if faults == []:
        certificate = ("The independent verifier found no violated constraint in any step.",)
    return Page(
        title=f"{'Run' if 'outcome' in data else 'Plan'} of {problem.name}",
        description=problem.description,
        words=result.words,
        certificate=certificate,
        map=PageMap(tracks, problem.obstacles) if tracks else None,
        tables=[
            _figures(result.task.key_figures(result)),
            *_result_tables(tables),
            *_settings(result.task.tables(problem), data.get("seed")),
        ],
        charts=[
            Chart(
                one.meaning,
                [_curve(0, one.name, table["t_s"], rounded(table[one.name], METRE_DIGITS))],
                *(TIME, plain(f"{one.name} [{one.unit or '1'}]")),
                over_time=True,
            )
            for columns, table in tables.values()
            if len(table.get("t_s", ())) > 1 and (np.diff(table["t_s"]) > 0.0).all()
            for one in columns
            if one.kind == "number" and not one.name.endswith(("t_s", "x_m", "y_m"))
        ],
    )


def _figures(figures: Iterable[tuple[str, object]]) -> PageTable:
    return PageTable("Key figures", ("name", "value"), list(figures_in_words(figures)))


def _events(table: Data) -> Iterator[Track]:
    """Yield the positions of each event of a table; NaN while the event is inactive."""
    if not {"event", "there", "t_s", "x_m", "y_m"} <= set(table):
        return
    for name in dict.fromkeys(table["event"].tolist()):
        own = table["event"] == name
        points = np.column_stack([table["x_m"][own], table["y_m"][own]])
        there = table["there"][own].astype(bool)
        yield Track(name, table["t_s"][own], np.where(there[:, None], points, np.nan), "event")


def _result_tables(tables: Mapping[str, tuple[Sequence[Column], Data]]) -> list[PageTable]:
    """Return the saved tables of a result."""
    found: list[PageTable] = []
    for file, (columns, data) in tables.items():
        header = [f"{one.name} [{one.unit}]" if one.unit else one.name for one in columns]
        values = [data[one.name] for one in columns]
        shown = list(zip(*(each[:MOST_ROWS].tolist() for each in values), strict=True))
        total = max(map(len, values), default=0)
        found.append(PageTable(f"Table {file}", header, shown, total, file))
    return found


def comparison_page(comparison: Comparison) -> Page:
    """Return the page of a comparison, with the tables of its first problem."""
    labels = setting_words(comparison)
    metrics = dict.fromkeys(row.metric for row in comparison.rows)
    rows = [
        (label, row.metric, row.mean, row.ci_low, row.ci_high, row.count, row.paired_ratio)
        for label, setting in zip(labels, comparison.settings, strict=True)
        for row in setting.rows.values()
    ]
    head = ("setting", "metric", "mean", "95 % from", "95 % to", "runs", "paired ratio")
    columns = run_columns(comparison)
    listed = [name for name in columns if name != "step_s"]
    counts = list(zip(*(columns[name] for name in listed), strict=True))
    others = [problem.name for problem in comparison.others]
    charts = [_metric_chart(comparison, metric, labels) for metric in metrics]
    bins = comparison.reliability
    if bins:
        points = scatter(
            "all settings",
            rounded([one.predicted for one in bins], PROBABILITY_DIGITS),
            rounded([one.realised for one in bins], PROBABILITY_DIGITS),
            text=[f"{one.count} predictions" for one in bins],
            marker={"size": 10, "color": colour_of(0)},
        )
        traces, label = [points, _line([0, 1], [0, 1], "equal")], "predicted P(connected) [1]"
        charts.append(Chart("Reliability", traces, label, "connected [1]"))
    return Page(
        title=f"Comparison of {', '.join([comparison.problem.name, *others])}",
        description=comparison.problem.description,
        words=comparison_text(comparison).splitlines(),
        charts=charts,
        tables=[
            PageTable("Settings and metrics", head, rows),
            PageTable("Runs", listed, counts, len(counts)),
            *_settings(task_of(comparison.problem).tables(comparison.problem), None),
        ],
    )


def _motion_map(problem: Problem, belief: Belief, tracks: Sequence[Track]) -> PageMap:
    goals = [robot.goal_m for robot in problem.robots if robot.goal_m is not None]
    shown = np.concatenate([*(track.positions_m for track in tracks), np.reshape(goals, (-1, 2))])
    window = map_window(problem, shown)
    mean, deviation, chance = believed_rasters(problem, belief, window)
    p_min, robots = problem.constraints.step_p_min, problem.robots
    starts = [(f"{one.name}, start", one.start_m, GREEN, "circle-open") for one in robots]
    ends = [(f"{one.name}, goal", one.goal_m, YELLOW, "star") for one in robots if one.goal_m]
    sites = [(one.name, one.site.position_m, ORANGE, "triangle-up") for one in problem.stations]
    return PageMap(
        tracks=tracks,
        obstacles=(*problem.workspace.lasting, *problem.workspace.timed),
        moving=problem.workspace.moving,
        layers=(
            Layer(
                "P(connected)", "1", "Cividis", chance, (0.0, 1.0), p_min if p_min > 0.0 else None
            ),
            Layer("predicted power", "dBm", "Viridis", mean),
            Layer("standard deviation", "dB", "Cividis", deviation),
        ),
        places=[
            {"name": name, "x": x, "y": y, "colour": colour, "symbol": symbol}
            for name, (x, y), colour, symbol in (*starts, *ends, *sites)
        ],
        window=window,
    )


def _planned(plan: Plan) -> Track:
    """Return the planned path of a robot."""
    powers = _by_step(plan, plan.mean_dbm), _by_step(plan, plan.connectivity)
    notes = [
        f"predicted {_known(power, ' dBm', 3)}, P(connected) {_known(chance)}"
        for power, chance in zip(*powers, strict=True)
    ]
    return Track(plan.robot, plan.t_s, plan.positions_m, plans=[plan.positions_m], notes=notes)


def _by_step(plan: Plan, values: Floats) -> Floats:
    """Return values at all positions of a plan, with leading NaN where values are missing."""
    missing = len(plan.t_s) - len(values)
    return np.concatenate([np.full(missing, np.nan), values])


def _driven(run: Run) -> Iterator[Track]:
    """Yield the driven path of each robot with its plans, then the path of the target."""
    for one, plans in zip(run.runs, run.plans, strict=True):
        yield Track(
            one.robot,
            one.log.t_s,
            one.log.positions_m,
            plans=[*(plan.positions_m for plan in plans), np.zeros((0, 2))],
            notes=_step_notes(one.log),
        )
    if run.target is not None:
        yield Track("target", run.runs[0].log.t_s, run.target.true_m, "target")


def _step_notes(log: StepLog) -> list[str]:
    """Return power, connection and verdict of every step as text."""
    return [
        f"predicted {_known(predicted, ' dBm', 3)}, received {_known(true, ' dBm', 3)}, "
        f"P(connected) {_known(chance)}, {verdict.value} ({rung.value})"
        + (", not connected" if is_out else "")
        for predicted, true, chance, is_out, verdict, rung in zip(
            log.predicted_dbm,
            log.true_dbm,
            log.connectivity,
            log.disconnected,
            log.verdict,
            log.rung,
            strict=True,
        )
    ]


def _known(value: float, unit: str = "", digits: int = 4) -> str:
    """Return a number with its unit as text; a dash for NaN."""
    return shown_number(None if np.isnan(value) else value, unit, digits)


def _run_certificates(run: Run) -> list[str]:
    """Return each robot's plan verdicts, minimum clearance and minimum connectivity as text."""
    lines: list[str] = []
    for plans in run.plans:
        if not plans:
            continue
        proofs = [plan.certificate for plan in plans]
        clearance = min(proof.min_clearance_m for proof in proofs)
        connectivity = min(proof.min_connectivity for proof in proofs)
        verdicts = [plan.verdict for plan in plans]
        lines.append(f"{plans[0].robot}: {planned_in_words(clearance, connectivity)}")
        lines += [
            f"  {verdicts.count(verdict)} of {len(plans)} plans {verdict.value}: {MEANING[verdict]}"
            for verdict in Verdict
            if verdict in verdicts
        ]
    return lines


def _planned_charts(problem: Problem, plans: Sequence[Plan]) -> list[Chart]:
    power, chance = list[Trace](), list[Trace]()
    for number, plan in enumerate(plans):
        mean, deviation = _by_step(plan, plan.mean_dbm), _by_step(plan, plan.deviation_db)
        power += _predicted(number, plan.robot, plan.t_s, mean, deviation)
        values = rounded(_by_step(plan, plan.connectivity), PROBABILITY_DIGITS)
        chance.append(_curve(number, plan.robot, plan.t_s, values))
    return _charts_over_time(problem, "Predicted power", power, chance, plans[0].t_s)


def _run_charts(run: Run) -> list[Chart]:
    power, chance, pairs = list[Trace](), list[Trace](), list[Trace]()
    for number, one in enumerate(run.runs):
        log = one.log
        power += _predicted(number, one.robot, log.t_s, log.predicted_dbm, log.deviation_db)
        true = rounded(log.true_dbm, POWER_DIGITS)
        look = {"color": BLACK, "symbol": SYMBOLS[number % len(SYMBOLS)], "size": 6}
        times = rounded(log.t_s, METRE_DIGITS)
        power.append(scatter(f"{one.robot}, received", times, true, marker=look))
        predicted = rounded(log.predicted_dbm, POWER_DIGITS)
        half = {"type": "data", "array": rounded(BAND_Z * log.deviation_db, POWER_DIGITS)}
        bars = {**half, "color": "#b3b3b3", "thickness": 1}
        look = {**look, "color": colour_of(number)}
        pairs.append(scatter(one.robot, predicted, true, error_x=bars, marker=look))
        values = rounded(log.connectivity, PROBABILITY_DIGITS)
        chance.append(_curve(number, one.robot, log.t_s, values))
    title, t_s = "Predicted and received power", run.runs[0].log.t_s
    charts = _charts_over_time(run.problem, title, power, chance, t_s)
    known = np.concatenate([one.log.true_dbm for one in run.runs])
    if not np.isfinite(known).any():
        return charts
    ends = rounded([np.nanmin(known), np.nanmax(known)], POWER_DIGITS)
    pairs.append(_line(ends, ends, "equal"))
    label = f"predicted one step ahead [dBm] ({BAND_WORDS})"
    title = "Received against predicted power"
    return [*charts, Chart(title, pairs, label, "received [dBm]")]


def _charts_over_time(
    problem: Problem, title: str, power: list[Trace], chance: list[Trace], t_s: Floats
) -> list[Chart]:
    """Return the charts of power and probability of connection, with their thresholds."""
    ends, p_min = [float(t_s[0]), float(t_s[-1])], problem.constraints.step_p_min
    for station in problem.stations:
        threshold = [station.threshold_dbm] * 2
        power.append(_line(ends, threshold, f"{station.name}, threshold"))
    if p_min > 0.0:
        chance.append(_line(ends, [p_min] * 2, f"p_min = {p_min:g}"))
    limits = {"yaxis": {"range": [-0.03, 1.03]}}
    return [
        Chart(title, power, TIME, "power [dBm]", over_time=True),
        Chart("Predicted connection", chance, TIME, "P(connected)", over_time=True, layout=limits),
    ]


def _predicted(
    number: int, robot: str, t_s: Floats, mean_dbm: Floats, deviation_db: Floats
) -> list[Trace]:
    """Return the curve of a robot's predicted power and its band."""
    known = np.isfinite(mean_dbm)
    half, mean, times = BAND_Z * deviation_db[known], mean_dbm[known], t_s[known]
    x = rounded(np.concatenate([times, times[::-1]]), METRE_DIGITS)
    y = rounded(np.concatenate([mean - half, (mean + half)[::-1]]), POWER_DIGITS)
    fill = f"{colour_of(number)}40"  # Two hexadecimal digits of opacity
    look = {"fill": "toself", "fillcolor": fill, "line": {"width": 0}, "hoverinfo": "skip"}
    band = scatter(f"{robot}, {BAND_WORDS}", x, y, "lines", **look)
    return [band, _curve(number, f"{robot}, predicted", t_s, rounded(mean_dbm, POWER_DIGITS))]


def _curve(number: int, name: str, t_s: Floats, values: list[Any]) -> Trace:
    """Return a curve in a robot's colour, for Plotly."""
    colour, times = colour_of(number), rounded(t_s, METRE_DIGITS)
    look = {"symbol": SYMBOLS[number % len(SYMBOLS)], "size": 5, "color": colour}
    line = {"color": colour, "width": 2}
    return scatter(name, times, values, "lines+markers", line=line, marker=look)


def _line(x: list[float], y: list[float], name: str) -> Trace:
    """Return a dashed line, for Plotly."""
    return scatter(name, x, y, "lines", line={"color": VERMILLION, "width": 1.5, "dash": "dash"})


def _metric_chart(comparison: Comparison, metric: str, labels: Sequence[str]) -> Chart:
    """Return the chart of a metric by setting: every run, and the mean with its interval."""
    scale = metric_name(metric).scale
    settings = list(zip(labels, comparison.settings, strict=True))
    dots = [
        (plain(label), run.metrics[metric] * scale)
        for label, setting in settings
        for run in setting.runs
        if np.isfinite(run.metrics.get(metric, np.nan))
    ]
    rows = [(plain(label), each.rows[metric]) for label, each in settings if metric in each.rows]
    known = [(label, row) for label, row in rows if row.mean is not None]
    means = np.array([row.mean for _, row in known], dtype=np.float64) * scale
    lows, highs = (
        np.array([getattr(row, end) for _, row in known], dtype=np.float64) * scale
        for end in ("ci_low", "ci_high")
    )
    bars = {
        "type": "data",
        "symmetric": False,
        "array": [float(one) for one in np.nan_to_num(highs - means)],
        "arrayminus": [float(one) for one in np.nan_to_num(means - lows)],
    }
    circle = {"symbol": "circle-open", "size": 7, "color": "#767676"}
    diamond = {"symbol": "diamond", "size": 11, "color": colour_of(0)}
    runs = scatter(
        "runs", [float(value) for _, value in dots], [label for label, _ in dots], marker=circle
    )
    mean = scatter(
        "mean, 95 % interval",
        means.tolist(),
        [label for label, _ in known],
        marker=diamond,
        error_x=bars,
    )
    layout = {"yaxis": {"type": "category", "automargin": True}}
    title, label = metric_name(metric).words, metric_label(metric)
    return Chart(title, [runs, mean], label, "", layout=layout)


def key_figures(result: Solution | Run) -> list[tuple[str, object]]:
    """Return the key figures of a plan or run."""
    if isinstance(result, Run):
        head = [("outcome", result.outcome.value), ("reason", result.reason)]
        numbers = {"verified_rate": result.verified_rate, **result.metrics}
        return [*head, *((name, float(value)) for name, value in numbers.items())]
    bound = result.bound
    return [
        ("verdict", result.verdict.value),
        ("objective", float(sum(plan.objective for plan in result.plans))),
        ("min_clearance_m", min(plan.certificate.min_clearance_m for plan in result.plans)),
        (
            "predicted_min_connectivity",
            min(plan.certificate.min_connectivity for plan in result.plans),
        ),
        ("bound", None if bound is None else bound.value),
        ("iterations", sum(plan.iterations for plan in result.plans)),
        ("wall_s", float(sum(plan.wall_s for plan in result.plans))),
    ]


def _settings(settings: Mapping[str, Any], seed: object) -> list[PageTable]:
    """Return two tables: the problem's keys, and the software versions."""
    keys = [("seed", seed), *_flat(settings)] if seed is not None else list(_flat(settings))
    return [
        PageTable("Settings", ("key", "value"), keys),
        PageTable("Versions that made this page", ("package", "version"), program()),
    ]


def _flat(table: Mapping[str, Any], head: str = "") -> Iterator[tuple[str, object]]:
    """Yield keys and values of nested tables; long lists are shortened."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(cast("Mapping[str, Any]", value), f"{head}{key}.")
        elif isinstance(value, list | tuple):
            text = json.dumps(value, default=str)
            yield f"{head}{key}", text if len(text) <= 200 else f"{text[:200]} ..."
        else:
            yield f"{head}{key}", value


MOST_FIGURES = 5  # Number of key figures next to the picture


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
