"""Pictures of results, drawn beside what is saved."""

from __future__ import annotations

from pathlib import Path

from planopt.channel.calibration import HeldOutReport
from planopt.channel.channel_map import PosteriorMap
from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.measurements import Measurements
from planopt.report import (
    draw_calibration,
    draw_comparison,
    draw_fit,
    draw_posterior_map,
    draw_reliability,
    draw_traces,
    save_figure,
)
from planopt.studies.comparison import Comparison


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
