"""Pictures of results, drawn beside what is saved."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.maps.posterior_map import PosteriorMap
from planopt.channel.measurements import Measurements
from planopt.channel.validation.held_out_report import HeldOutReport
from planopt.planning.loop.simulation import Simulation
from planopt.planning.plan import Plan
from planopt.planning.solution import Solution
from planopt.planning.team.team_run import TeamRun
from planopt.problems.problem import Problem
from planopt.report.belief_map import draw_belief
from planopt.report.calibration_figure import draw_calibration
from planopt.report.comparison_figure import draw_comparison
from planopt.report.fit_figure import draw_fit
from planopt.report.map_figure import draw_posterior_map
from planopt.report.plan_figure import draw_plan
from planopt.report.reliability_figure import draw_reliability
from planopt.report.run_figure import draw_run
from planopt.report.run_series import draw_run_series
from planopt.report.saving import save_figure
from planopt.report.team_figure import draw_team_plan, draw_team_run
from planopt.studies.comparison import Comparison


def picture_solution(solution: Solution, folder: Path) -> None:
    """The plan, and what was believed of the channel."""
    save_figure(draw_plan(solution), folder / "plan.png")
    save_figure(draw_belief(solution.problem, solution.belief), folder / "belief.png")


def picture_simulation(simulation: Simulation, folder: Path) -> None:
    """The way driven, its time series, and the belief at its end."""
    save_figure(draw_run(simulation), folder / "run.png")
    save_figure(draw_run_series(simulation), folder / "series.png")
    save_figure(draw_belief(simulation.problem, simulation.belief), folder / "belief.png")


def picture_team_run(run: TeamRun, folder: Path) -> None:
    """The ways driven on the belief at their end, with the time series beside."""
    save_figure(draw_team_run(run), folder / "run.png")


def animate(run: Simulation | TeamRun, folder: Path) -> None:
    """The run step by step."""
    from planopt.report.animation import save_animation

    save_animation(run, folder / "run.gif")


def picture_team_plan(
    problem: Problem,
    plans: Sequence[Plan],
    belief: Belief,
    target_m: NDArray[np.float64] | None,
    folder: Path,
) -> None:
    """The plan of every robot; arguments as of :func:`draw_team_plan`."""
    save_figure(draw_team_plan(problem, plans, belief, target_m), folder / "plan.png")


def picture_comparison(comparison: Comparison, folder: Path) -> None:
    """The table as a chart, and predicted against true connection where there was a step."""
    save_figure(draw_comparison(comparison), folder / "comparison.png")
    if comparison.reliability:
        title = f"{comparison.problem.name}: connection over {len(comparison.runs)} runs"
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
