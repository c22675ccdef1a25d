"""Beliefs of a replay: learnt again from the initial data, and compared with ``belief.npz``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.measurements import Measurements
from planopt.channel.posterior import condition
from planopt.files.compare import differences, in_words
from planopt.planning.files.belief_file import Arrays, SavedBelief, station_prefix
from planopt.planning.initial_data import learn_stations
from planopt.problems.problem import Problem

VALUES, NOISE = "values_db", "noise_variance_db2"
"""Arrays of the Gaussian sites."""


def initial_belief(problem: Problem, first: Sequence[Measurements], saved: SavedBelief) -> Belief:
    """Return the belief before the first step: the fit made again, predictions as they were saved.

    Saved parameters are those of the predictions, because a fit on another machine differs a
    little. They are compared with the fit made again.
    """
    learnt = learn_stations(problem, first)
    each = [
        _with_parameters(replace(own, further=()), said)
        for own, said in zip((learnt, *learnt.further), saved.stations, strict=True)
    ]
    return replace(each[0], further=tuple(each[1:]))


def _with_parameters(belief: Belief, saved: SavedBelief) -> Belief:
    """Return a belief conditioned with the saved parameters."""
    learnt = belief.posterior
    if saved.parameters == learnt.parameters:
        return belief
    posterior = condition(
        saved.parameters,
        learnt.measurements,
        theta="known" if learnt.theta_known else "estimated",
    )
    return replace(belief, posterior=posterior)


def belief_reasons(saved: SavedBelief, found: Arrays, seed: int) -> list[str]:
    """Return the differences of the saved arrays from those found again."""
    said = {
        station_prefix(station) + name: array
        for station, own in enumerate(saved.stations)
        for name, array in own.arrays.items()
    }
    return in_words(
        saved.file.name,
        differences(_comparable(said), _comparable(found)),
        f"found with seed {seed}",
    )


def _comparable(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Return arrays as lists, and Gaussian sites in natural units, in which they converge."""
    lists: dict[str, Any] = {name: array.tolist() for name, array in arrays.items()}
    for name, variance in arrays.items():
        values = arrays.get(name.removesuffix(NOISE) + VALUES)
        if name.endswith(NOISE) and values is not None and values.shape == variance.shape:
            lists[name] = {"precision": (1.0 / variance).tolist()}
            lists[name.removesuffix(NOISE) + VALUES] = {
                "precision_mean": (values / variance).tolist()
            }
    return lists
