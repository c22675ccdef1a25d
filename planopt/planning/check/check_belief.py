"""Judge ``belief.npz``: what was measured where, and what follows from it.

The first measurements are taken again from the truth that problem and seed give, the channel is
fitted to them again, and those of the run are where and what the run could measure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.fields.truth import Truth, measure
from planopt.channel.measurements import Measurements, join
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.objectives.measuring import closing_m
from planopt.planning.check.agreement import Disagreement, disagreements, in_words
from planopt.planning.files.belief_file import (
    SavedBelief,
    belief_arrays,
    parameter_arrays,
    station_prefix,
)
from planopt.planning.given import Given, draw
from planopt.planning.loop.learn import learn
from planopt.problems.channel_setup import SampledMeasurements
from planopt.problems.problem import Problem

SITE_TOLERANCE = 1e-5
"""Sites come from an iteration that stops at 1e-7; natural units of each."""

NEARNESS_TIE_M = 1e-9
"""A place whose distance to the next measurement is this near to the spacing may count as either
side of it: another machine rounds otherwise."""


@dataclass(frozen=True, eq=False)
class Taken:
    """The measurements taken on the way of a run."""

    places_m: NDArray[np.float64]  # (k, 2) where
    true_dbm: NDArray[np.float64]  # (k,) the true power there, NaN where nobody knows it
    # (steps,) how many measurements of the first station there were before each step
    known_before_step: NDArray[np.int64]

    @property
    def learnt(self) -> list[bool]:
        """Return whether something was measured after each step."""
        known = self.known_before_step
        if not len(known):
            return []
        after = np.append(known[1:], known[0] + len(self.places_m))
        return (after > known).tolist()


NOTHING_TAKEN = Taken(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=np.int64))


def has_no_truth(problem: Problem) -> bool:
    """Return whether a saved problem says neither what the channel was nor what was measured."""
    channel = problem.channel
    measured = channel.measurements
    is_none = isinstance(measured, SampledMeasurements) and measured.count == 0
    known = channel.given is not None and channel.given.k_pl_db is not None
    return channel.truth is None and is_none and not known


def given_again(problem: Problem, seed: int) -> tuple[Given | None, list[str]]:
    """Return what problem and seed give; None, and a remark, if its files are not to be had."""
    if has_no_truth(problem):
        return None, [
            "true powers and first measurements are taken as they stand: the file has no ground "
            "truth, as where it is from Python, or measurements were given"
        ]
    try:
        return draw(problem, seed), []
    except InputError as error:
        return None, [
            f"true powers and first measurements are taken as they stand, because they cannot be "
            f"drawn again: {error}"
        ]


def taken_on_the_way(
    problem: Problem,
    belief: SavedBelief,
    tracks_m: NDArray[np.float64],
    true_dbm: NDArray[np.float64],
) -> Taken:
    """Return where robots measure in turn: not near an earlier measurement."""
    # Shapes: tracks_m, true_dbm (robots, steps + 1, 2).
    known = [[*own.measurements.positions_m[: own.first]] for own in belief.stations]
    spacing = closing_m(problem.channel.measure_spacing_m)
    said = np.diff([*belief.known_before_step, len(belief.measurements)])
    counts: list[int] = []
    taken: list[tuple[int, int]] = []
    for step in range(1, tracks_m.shape[1]):
        counts.append(len(known[0]))
        for robot, place in enumerate(tracks_m[:, step]):
            nearest = max(_nearest_m(places, place) for places in known)
            is_tie = abs(nearest - spacing) <= NEARNESS_TIE_M
            some_left = len(known[0]) < counts[-1] + said[step - 1]
            if some_left if is_tie else nearest >= spacing:
                for places in known:
                    places.append(place)
                taken.append((robot, step))
    robots, steps = np.array(taken, dtype=np.intp).reshape(-1, 2).T
    return Taken(tracks_m[robots, steps], true_dbm[robots, steps], np.array(counts, np.int64))


def _nearest_m(places_m: list[NDArray[np.float64]], place_m: NDArray[np.float64]) -> float:
    """Return how far the nearest of some places is; infinite where there is none."""
    return float(np.linalg.norm(places_m - place_m, axis=1).min()) if places_m else np.inf


def learnt_again(
    problem: Problem, saved: Sequence[SavedBelief]
) -> tuple[list[list[Belief]], list[str]]:
    """Return what the initial measurements imply for each station, or why they do not."""
    found: list[list[Belief]] = []
    for belief in saved:
        try:
            found.append(
                [
                    learn(problem, own.measurements.take(slice(own.first)), station)
                    for station, own in enumerate(belief.stations)
                ]
            )
        except InputError as error:
            reason = f"the first {belief.first} measurements cannot be fitted: {error}"
            return [], [f"{belief.file.name}: {reason}"]
    return found, []


def belief_again(learnt: Sequence[Belief], posteriors: Sequence[ChannelPosterior]) -> Belief:
    """Return a belief with the fits of :func:`learnt_again` and the last posteriors."""
    each = [replace(own, posterior=last) for own, last in zip(learnt, posteriors, strict=True)]
    return replace(each[0], further=tuple(each[1:]))


def belief_reasons(
    problem: Problem,
    belief: SavedBelief,
    learnt: Sequence[Belief],
    posteriors: Sequence[ChannelPosterior],
    given: Given | None,
    taken: Taken,
    seed: int,
) -> list[str]:
    """Return what in the file cannot be so."""
    reasons: list[str] = []
    each = zip(belief.stations, learnt, posteriors, strict=True)
    for station, (own, first, posterior) in enumerate(each):
        drawn = None if given is None else given.stations[station]
        reasons += _station_reasons(problem, station, own, first, posterior, drawn, taken, seed)
    return reasons


def _station_reasons(
    problem: Problem,
    station: int,
    belief: SavedBelief,
    learnt: Belief,
    posterior: ChannelPosterior,
    given: Given | None,
    taken: Taken,
    seed: int,
) -> list[str]:
    """Return what in the file cannot be so of one station."""
    file, prefix = belief.file.name, station_prefix(station)
    first = belief.measurements.take(slice(belief.first))
    start = first if given is None else given.measurements
    truth = None if given is None else given.truth
    alone = len(problem.stations) == 1
    measurements = join(start, _measured(belief, truth, taken, alone=alone))
    known = taken.known_before_step - taken.known_before_step[:1] + belief.first
    found = {
        **belief_arrays(Belief(learnt.fit, posterior), known),
        **parameter_arrays(learnt.fit.parameters),
        **{part.name: getattr(measurements, part.name) for part in fields(Measurements)},
        "first_measurements": np.array(len(start)),
        "theta_known": np.array(learnt.posterior.theta_known),
    }
    sites = ("values_db", "noise_variance_db2")
    differences = disagreements(
        {
            prefix + name: array.tolist()
            for name, array in belief.arrays.items()
            if name not in sites
        },
        {
            prefix + name: array.tolist()
            for name, array in found.items()
            # Files from before receivers and drift have no such arrays.
            if name not in sites and (name in belief.arrays or name not in OPTIONAL_ARRAYS)
        },
    )
    return [
        *in_words(file, differences, f"found with seed {seed}"),
        *in_words(file, iter(_site_differences(belief, posterior, prefix))),
    ]


OPTIONAL_ARRAYS = ("resolution_db", "position_std_m", "time_s", "receiver", "forgetting_s")


def _measured(
    belief: SavedBelief, truth: Truth | None, taken: Taken, *, alone: bool
) -> Measurements:
    """Return what is measured at the places of a run; without a truth, its rows say what was true.

    Rows have the serving power, which is a station's own only where that is alone.
    """
    if truth is not None:
        return measure(truth, taken.places_m)
    said = belief.measurements.take(slice(belief.first, None))
    if not alone and len(said) == len(taken.places_m):
        return replace(said, positions_m=taken.places_m)
    censored = said.censored
    if len(censored) != len(taken.places_m):
        censored = np.zeros(len(taken.places_m), dtype=np.bool_)
    return Measurements(taken.places_m, np.nan_to_num(taken.true_dbm), censored)


def _site_differences(
    belief: SavedBelief, posterior: ChannelPosterior, prefix: str
) -> list[Disagreement]:
    """Gaussian sites that are not those of the rebuilt posterior, in natural units."""
    said_precision, precision = 1.0 / belief.noise_variance_db2, 1.0 / posterior.noise_variance_db2
    found: list[Disagreement] = []
    for name, said, again, said_db, again_db in (
        (
            "noise_variance_db2",
            said_precision,
            precision,
            belief.noise_variance_db2,
            posterior.noise_variance_db2,
        ),
        (
            "values_db",
            belief.values_db * precision,
            posterior.values_db * precision,
            belief.values_db,
            posterior.values_db,
        ),
    ):
        differs = ~np.isclose(said, again, rtol=SITE_TOLERANCE, atol=SITE_TOLERANCE)
        found += [
            Disagreement(f"{prefix}{name}[{row}]", f"{said_db[row]:.9g}", f"{again_db[row]:.9g}")
            for row in np.flatnonzero(differs).tolist()
        ]
    return found
