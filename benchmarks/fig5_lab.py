"""Fig. 5 of [GM11] in measured power: the log of a room is the ground truth.

The folder has ``dcm_rssi.csv`` and ``transmitters.csv`` of the data set DCM-RSSI (Yang et al., IROS
2024, repository wenhaol/DCM-RSSI), which is not part of planopt: a robot drove through a room of 5
by 5.5 m with a Wi-Fi router at each of 92 places. One place of the router is the station; a cell
has the power that was measured nearest to it. The room is smaller than the building of [GM11], so
that the target is slow enough to stay in it:

    python benchmarks/fig5_lab.py FOLDER --transmitter 40 --threshold -32 --seeds 100:120
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from planopt import (
    BaseStation,
    InputError,
    Measurements,
    PlanoptError,
    Problem,
    Workspace,
    compare,
    load,
)
from planopt.channel import Station, fit_channel
from planopt.problems import ArrayTruth, GivenParameters, SampledMeasurements
from planopt.problems.settings import seeds_of
from planopt.report import comparison_text
from planopt.world import cell_centres_m

CELL_M, MARGIN_M, FIRST = 0.1, 0.2, 20
"""Side of a cell, room beyond the measured places, and how many are measured before the run."""

TARGET_SPEED_M_S, TARGET_AWAY_M, SPREAD_M = 0.04, 0.5, 1.0
"""The target and the robot start about the middle of the room."""


def table(file: Path, columns: Sequence[int]) -> np.ndarray:
    """Read columns of a file of the data set; an InputError says what is missing."""
    try:
        return np.loadtxt(file, delimiter=",", skiprows=2, usecols=columns, ndmin=2)
    except (OSError, ValueError, IndexError) as error:
        raise InputError(
            f"cannot be read: {error}",
            file=file,
            remedy="name the folder of the data set DCM-RSSI, which is not part of planopt",
        ) from None


def lab_problem(folder: Path, transmitter: int, threshold_dbm: float) -> Problem:
    """Make the problem of Fig. 5 whose ground truth is what was measured of a transmitter.

    Parameters
    ----------
    folder
        Of the data set.
    transmitter
        Its number in ``transmitters.csv``.
    threshold_dbm
        Power from which on packets arrive.

    Raises
    ------
    InputError
        A file is missing or damaged, or there is no such transmitter.
    """
    places = table(folder / "transmitters.csv", (0, 2, 3))
    log = table(folder / "dcm_rssi.csv", (0, 1, 2, 3))
    (found,) = np.nonzero(places[:, 0] == transmitter)
    measured = log[log[:, 0] == transmitter, 1:]
    if not len(found) or not len(measured):
        raise InputError(
            f"has no measurements of transmitter {transmitter}",
            file=folder / "transmitters.csv",
            remedy=f"use one of {places[0, 0]:.0f} to {places[-1, 0]:.0f}",
        )
    x, y = (float(value) for value in places[found[0], 1:])
    power = measured[:, 2]
    exact = np.zeros(len(power), dtype=np.bool_)
    fit = fit_channel(Measurements(measured[:, :2], power, exact), Station((x, y)))
    low, high = measured[:, :2].min(axis=0) - MARGIN_M, measured[:, :2].max(axis=0) + MARGIN_M
    bounds = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    across, along = (cell_centres_m(bounds[side], bounds[2 + side], CELL_M) for side in range(2))
    cells = np.stack(np.meshgrid(across, along), axis=-1)
    _, nearest = cKDTree(measured[:, :2]).query(cells.reshape(-1, 2))
    middle = (0.5 * (bounds[0] + bounds[2]), 0.5 * (bounds[1] + bounds[3]))
    fig5 = load("fig5")
    parameters = fit.parameters
    return replace(
        fig5,
        name="fig5_lab",
        workspace=Workspace(bounds),
        stations=(
            BaseStation(
                name="router",
                position_m=(x, y),
                transmit_power_dbm=0.0,
                threshold_dbm=threshold_dbm,
            ),
        ),
        robots=tuple(
            replace(robot, start_m=middle, start_spread_m=SPREAD_M) for robot in fig5.robots
        ),
        targets=tuple(
            replace(
                target,
                start_m=middle,
                start_distance_m=TARGET_AWAY_M,
                velocity_m_s=(TARGET_SPEED_M_S, 0.0),
                acceleration_std_m_s2=0.01 * target.acceleration_std_m_s2,
            )
            for target in fig5.targets
        ),
        channel=replace(
            fig5.channel,
            truth=ArrayTruth(
                x_m=across, y_m=along, power_dbm=power[nearest].reshape(cells.shape[:2])
            ),
            measurements=SampledMeasurements(FIRST),
            given=GivenParameters(
                k_pl_db=parameters.k_pl_db,
                n_pl=parameters.n_pl,
                shadow_std_db=parameters.shadow_std_db,
                decorrelation_m=parameters.decorrelation_m,
                multipath_std_db=parameters.multipath_std_db,
            ),
        ),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare the strategies of fig5 on the log; print the table."""
    parser = argparse.ArgumentParser(description="Fig. 5 of [GM11] in measured power.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--transmitter", type=int, default=40)
    parser.add_argument("--threshold", type=float, default=-32.0)
    parser.add_argument("--seeds", default="100:120")
    asked = parser.parse_args(arguments)
    try:
        problem = lab_problem(asked.folder, asked.transmitter, asked.threshold)
        print(comparison_text(compare(problem, seeds=seeds_of(asked.seeds, "--seeds"))))
    except PlanoptError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
