"""Pictures of results, drawn beside what is saved."""

from __future__ import annotations

from pathlib import Path

from planopt.channel.calibration import HeldOutReport
from planopt.channel.channel_map import PosteriorMap
from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.measurements import Measurements
from planopt.planning.holes import BlockedError
from planopt.planning.learn import prepare
from planopt.planning.results import Run, Solution
from planopt.problems.problem import Problem
from planopt.report import (
    draw_belief,
    draw_calibration,
    draw_comparison,
    draw_fit,
    draw_no_plan,
    draw_posterior_map,
    draw_reliability,
    draw_run,
    draw_run_series,
    draw_solution,
    draw_traces,
    save_figure,
)
from planopt.studies.comparison import Comparison


def picture_solution(solution: Solution, folder: Path) -> None:
    """The plans, and what was believed of the channel where there is a goal."""
    save_figure(draw_solution(solution), folder / "plan.png")
    if solution.problem.task == "reach":
        save_figure(draw_belief(solution.problem, solution.belief), folder / "belief.png")


def picture_no_plan(problem: Problem, seed: int, error: BlockedError, folder: Path) -> None:
    """The ways that a hard bound forbids."""
    belief = prepare(problem, seed).belief
    save_figure(draw_no_plan(problem, belief, str(error), error.blocked), folder / "plan.png")


def picture_run(run: Run, folder: Path) -> None:
    """The ways driven; to a goal also the belief at the end, and of one robot its time series."""
    save_figure(draw_run(run), folder / "run.png")
    if run.problem.task == "reach":
        if len(run.runs) == 1:
            save_figure(draw_run_series(run), folder / "series.png")
        save_figure(draw_belief(run.problem, run.beliefs[0]), folder / "belief.png")


def animate(run: Run, folder: Path) -> None:
    """The run step by step."""
    from planopt.report import save_animation

    save_animation(run, folder / "run.gif")


def picture_comparison(comparison: Comparison, folder: Path) -> None:
    """The table as a chart, and what there is: traces over time, and reliability of connection."""
    save_figure(draw_comparison(comparison), folder / "comparison.png")
    traces = draw_traces(comparison)
    if traces is not None:
        save_figure(traces, folder / "traces.png")
    if comparison.reliability:
        names = ", ".join(one.name for one in (comparison.problem, *comparison.others))
        title = f"{names}: connection over {len(comparison.runs)} runs"
        series = {"all settings": comparison.reliability}
        save_figure(draw_reliability(series, title), folder / "reliability.png")


def picture_fit(measurements: Measurements, fit: ChannelFit, folder: Path) -> None:
    """The fitted path loss and correlation over the measurements."""
    save_figure(draw_fit(measurements, fit, fit.parameters.station), folder / "fit.png")


def picture_held_out(report: HeldOutReport, folder: Path) -> None:
    """Coverage and PIT of what was held out."""
    calibrations = {
        name.replace("_", " "): score.calibration for name, score in report.scores.items()
    }
    save_figure(draw_calibration(calibrations), folder / "held_out.png")
    series = {name.replace("_", " "): score.reliability for name, score in report.scores.items()}
    title = f"P(power at least {report.threshold_dbm:g} dBm), held out"
    save_figure(draw_reliability(series, title), folder / "reliability.png")


def picture_map(
    maps: PosteriorMap, measurements: Measurements, fit: ChannelFit, title: str, file: Path
) -> None:
    """Predicted power, its deviation and the chance of a connection."""
    save_figure(draw_posterior_map(maps, measurements, fit.parameters.station, title), file)
