"""Predictions at measured sites: the channel against path loss alone and a plain Gaussian process.

The flat is part of planopt; campus and laboratory are read from the folder that the environment
variable PLANOPT_DATA names, and left out without it. Held out are a drive (flat), a day (campus), a
share of the drive in pieces or one side of the room (laboratory), or random readings. Errors are
averaged over transmitters and splits, with bootstrap intervals over them. A held-out reading counts
if it is above the receiver's floor, and predictors that know of the floor predict it by the mean of
their distribution above it (the plain process learns from such readings only). Rows of the
laboratory are numbered in time, and --undated leaves out the times of all logs:

    python benchmarks/measured_sites.py --rows 300 --seeds 600:602
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import norm

from planopt.channel import Measurements, Station, condition, fit_channel, predict_readings
from planopt.channel.held_out import learn_path_loss, learn_plain_process
from planopt.problems.library import library_folder
from planopt.problems.settings import seeds_of

LEVELS, TINY = (0.5, 0.8, 0.95), 1e-12
MOST_TESTED, BOOTSTRAPS = 1_000, 2_000
DAYS_APART_S = 1e6  # Times of the campus log are from the start of each day
SIDE_SHARE, PIECES, PIECES_OUT, LAB_STEP = 0.3, 10, 3, 4


@dataclass(frozen=True)
class Log:
    """Readings of one transmitter, with a label that can be held out as a whole."""

    station: Station
    places_m: np.ndarray
    power_dbm: np.ndarray
    censored: np.ndarray
    group: np.ndarray
    time_s: np.ndarray


def table(file: Path) -> np.ndarray:
    """Read a table with a header; lines before it begin with #."""
    lines = [line for line in file.read_text().splitlines() if not line.startswith("#")]
    return np.genfromtxt(lines, delimiter=",", names=True, dtype=None, encoding="utf-8")


def log_of(rows: np.ndarray, station: Station, group: str | None, floor: str | None = None) -> Log:
    """Return the rows of a transmitter as a log."""
    places = np.column_stack([rows["x_m"], rows["y_m"]]).astype(float)
    nothing = np.zeros(len(rows), dtype=bool)
    return Log(
        station,
        places,
        rows["power_dbm"].astype(float),
        nothing if floor is None else rows[floor] == 1,
        nothing if group is None else rows[group],
        np.arange(len(rows), dtype=float)
        if "t_s" not in (rows.dtype.names or ())
        else rows["t_s"] + (0.0 if group is None else DAYS_APART_S * rows[group]),
    )


def flat_logs(robot_height_m: float = 0.2) -> Iterator[Log]:
    """Yield the logs of the six anchors."""
    data = library_folder() / "data"
    rows = table(data / "flat_log.csv")
    for anchor in table(data / "flat_anchors.csv"):
        place = (float(anchor["x_m"]), float(anchor["y_m"]))
        station = Station(place, float(anchor["height_m"]) - robot_height_m)
        yield log_of(rows[rows["anchor"] == anchor["anchor"]], station, "drive")


def campus_logs(folder: Path) -> Iterator[Log]:
    """Yield the logs of the three receivers."""
    for row in table(folder / "campus" / "stations.csv"):
        station = Station((float(row["x_m"]), float(row["y_m"])))
        rows = table(folder / "campus" / f"{row['station']}.csv")
        yield log_of(rows, station, "day", "near_floor")


def lab_logs(folder: Path, first: int) -> Iterator[Log]:
    """Yield the logs of every fourth place of the router."""
    rows = table(folder / "lab" / "dcm_rssi.csv")
    for place in table(folder / "lab" / "transmitters.csv")[first % LAB_STEP :: LAB_STEP]:
        station = Station((float(place["x_m"]), float(place["y_m"])))
        yield log_of(rows[rows["tx_id"] == place["tx_id"]], station, None)


def splits(log: Log, kind: str, rows: int, random: np.random.Generator) -> Iterator[np.ndarray]:
    """Yield masks of the readings that are held out."""
    count = len(log.power_dbm)
    if kind == "group":
        yield from (log.group == label for label in np.unique(log.group))
    elif kind == "pieces":
        yield np.isin(np.arange(count) * PIECES // count, random.permutation(PIECES)[:PIECES_OUT])
    elif kind == "side":
        angle = random.uniform(0.0, 2.0 * np.pi)
        along = log.places_m @ [np.cos(angle), np.sin(angle)]
        yield along > np.quantile(along, 1.0 - SIDE_SHARE)
    else:
        out = np.ones(count, dtype=bool)
        out[random.permutation(count)[:rows]] = False
        yield out


def scores(
    log: Log, out: np.ndarray, rows: int, method: str, dated: bool, random: np.random.Generator
) -> dict:
    """Return RMSE, coverage and sums of squares far from the readings of each predictor."""
    known = np.sort(random.permutation(np.flatnonzero(~out))[:rows])
    tested = random.permutation(np.flatnonzero(out & ~log.censored))[:MOST_TESTED]
    learnt = Measurements(
        log.places_m[known],
        log.power_dbm[known],
        log.censored[known],
        time_s=log.time_s[known] if dated else np.zeros(len(known)),
    )
    readings = Measurements(
        log.places_m[tested],
        log.power_dbm[tested],
        time_s=log.time_s[tested] if dated else np.zeros(len(tested)),
    )
    fit = fit_channel(learnt, log.station, method)
    found = {
        "channel": predict_readings(condition(fit.parameters, learnt), readings),
        "path_loss": learn_path_loss(learnt, log.station)(readings),
        "plain_process": learn_plain_process(learnt)(readings),
    }
    away, _ = cKDTree(learnt.positions_m).query(readings.positions_m)
    far = away > fit.parameters.decorrelation_m
    score: dict = {"far": int(far.sum())}
    floor_dbm = log.power_dbm[log.censored].max(initial=-np.inf)
    for name, prediction in found.items():
        mean, deviation = prediction.mean_db, prediction.deviation_db
        floor = np.full(len(mean), -np.inf if name == "plain_process" else floor_dbm)
        above = norm.sf(floor, mean, deviation)
        hazard = np.where(
            above > TINY, norm.pdf(floor, mean, deviation) / np.maximum(above, TINY), 0
        )
        error = readings.power_dbm - np.maximum(mean + deviation**2 * hazard, floor)
        below = norm.sf(readings.power_dbm, mean, deviation) / np.maximum(above, TINY)
        score[name] = float(np.sqrt((error**2).mean()))
        score[name, "far"] = float((error[far] ** 2).sum())
        for level in LEVELS:
            score[name, level] = float((np.abs(below - 0.5) <= 0.5 * level).mean())
    return score


def interval(values: np.ndarray, random: np.random.Generator) -> str:
    """Return a mean with its 95 % bootstrap interval as text."""
    drawn = values[random.integers(0, len(values), (BOOTSTRAPS, len(values)))].mean(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{values.mean():.2f} ({low:.2f} to {high:.2f})"


def report(site: str, found: list[dict], random: np.random.Generator) -> None:
    """Print the row of a site."""
    names = ("channel", "path_loss", "plain_process")
    of = {name: np.array([score[name] for score in found]) for name in names}
    drawn = random.integers(0, len(found), (BOOTSTRAPS, len(found)))
    better = np.minimum(
        of["path_loss"][drawn].mean(axis=1), of["plain_process"][drawn].mean(axis=1)
    )
    low, high = np.quantile(of["channel"][drawn].mean(axis=1) / better, [0.025, 0.975])
    ratio = of["channel"].mean() / min(of["path_loss"].mean(), of["plain_process"].mean())
    covered = [100.0 * np.mean([score["channel", level] for score in found]) for level in LEVELS]
    print(
        f"| {site} | {len(found)} | {' | '.join(interval(of[name], random) for name in names)} | "
        f"{ratio:.3f} ({low:.3f} to {high:.3f}) | {', '.join(f'{each:.1f}' for each in covered)} |",
        flush=True,
    )


def main() -> None:
    """Print a table of all sites."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=300, help="readings of each fit")
    parser.add_argument("--seeds", default="0:1", help="seeds, first:end")
    parser.add_argument("--method", default="map", help="estimation method")
    parser.add_argument("--undated", action="store_true", help="leave out the times of the logs")
    options = parser.parse_args()
    seeds = seeds_of(options.seeds)
    folder = Path(os.environ.get("PLANOPT_DATA", "data"))
    kinds = {"flat": ("group", "random")}
    if (folder / "campus").is_dir():
        kinds |= {"campus": ("group", "side", "random")}
    if (folder / "lab").is_dir():
        kinds |= {"lab": ("pieces", "side", "random")}
    names = ("channel", "path loss", "plain process")
    columns = " | ".join(f"{name} [dB]" for name in names)
    print(f"| site, held out | fits | {columns} | ratio to the better | inside 50, 80, 95 % [%] |")
    print("|---|---|---|---|---|---|---|")
    every: list[dict] = []
    for site, held_out in kinds.items():
        for kind in held_out:
            found: list[dict] = []
            for seed in seeds:
                random = np.random.default_rng(seed)
                logs = {
                    "flat": flat_logs,
                    "campus": lambda: campus_logs(folder),
                    "lab": lambda seed=seed: lab_logs(folder, seed),
                }[site]()
                for log in logs:
                    for out in splits(log, kind, options.rows, random):
                        if (~out).sum() >= 10 and (out & ~log.censored).sum() >= 10:
                            dated = not options.undated
                            found.append(
                                scores(log, out, options.rows, options.method, dated, random)
                            )
            report(f"{site}, {kind}", found, np.random.default_rng(0))
            every += found
    count = sum(score["far"] for score in every)
    far = {
        name: np.sqrt(sum(score[name, "far"] for score in every) / count)
        for name in ("channel", "path_loss", "plain_process")
    }
    print(f"\nbeyond one decorrelation distance, {count} readings:", end=" ")
    print(", ".join(f"{name} {value:.2f} dB" for name, value in far.items()))


if __name__ == "__main__":
    main()
