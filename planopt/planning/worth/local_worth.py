"""The worth of a path near a start path, with exact derivatives, at a cost that does not grow.

The channel is that of the measurements nearest to the start path; cusps are rounded. What a solver
returns is valued again by :mod:`planopt.planning.worth.path_worth` and judged by the verifier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.batch_derivatives import PathDerivatives, add_own_blocks
from planopt.objectives.information_derivatives import (
    average_reduction_derivatives,
    path_information_derivatives,
    path_loss_derivatives,
)
from planopt.objectives.local_channel import LocalChannel, LocalGrid, local_channel, local_grid
from planopt.objectives.measuring import Gates
from planopt.objectives.motion_derivatives import path_length_derivatives
from planopt.objectives.path_form_derivatives import path_uncertainty_derivatives
from planopt.objectives.terms.term import Structure
from planopt.objectives.tracking_derivatives import connectivity_derivatives
from planopt.objectives.until_connected import LATER, Search
from planopt.objectives.until_connected_derivatives import charged_distance_derivatives
from planopt.planning.programme.path_value import (
    EvaluatePath,
    Evaluation,
    PathValue,
    remembering,
)
from planopt.planning.programme.stage_kernel import margins_of
from planopt.planning.worth.region import region_along
from planopt.planning.worth.rule_rows import RuleRows, has_step_rows, rule_rows
from planopt.planning.worth.serving_stages import (
    StagePower,
    serving_of,
    stage_powers,
    stage_predictor,
)
from planopt.planning.worth.situation import Situation
from planopt.planning.worth.stage_terms import stage_term_derivatives
from planopt.planning.worth.structure import structure_of
from planopt.problems.objective import (
    CasadiTerm,
    LearningTerm,
    MappingTerm,
    MotionEnergyTerm,
    Term,
    TrackingTerm,
    TransmissionEnergyTerm,
    UntilConnectedTerm,
)
from planopt.problems.problem import Problem
from planopt.targets.rounding import Derivatives, rounded_length

JOINT_NEIGHBOURS = 128
"""Measurements shared by the places of a path in terms that couple them."""

LENGTH_ROUNDING_SHARE = 0.01
"""Width of the rounding of a length at zero, as a share of the longest step."""


def needs_stages(problem: Problem) -> bool:
    """Whether predictions of single stages are needed: by a term, or to bound connectivity."""
    return problem.constraints.asks_connection or any(term.needs_power for term in problem.terms)


def local_worth(
    situation: Situation, path_m: NDArray[np.float64], rows: RuleRows | None = None
) -> EvaluatePath:
    """Worth about a start path (N, 2), and what a solver must bound by `rows`."""
    problem, posterior = situation.problem, situation.posterior
    structure = structure_of(problem)
    predict_stages = (
        stage_predictor(
            posterior, situation.circumstances.broad, path_m, problem.planner.neighbours
        )
        if needs_stages(problem)
        else None
    )
    joint = _joint_channels(situation, path_m)
    rule = None
    if any(term.is_measured for term in problem.terms):
        rule = situation.near_measuring
    # Each place keeps to the turn that its start sees: places that move little see it too.
    steering = situation.steering
    ahead = None if steering is None else steering.next_turns(path_m)
    tried = None
    if any(term.tries_connection for term in problem.terms):
        tried = situation.tries.takes(path_m)
    rows = rows if rows is not None else rule_rows(situation, path_m)
    z = rows.quantile
    bounded = has_step_rows(problem)

    def evaluate(places_m: NDArray[np.float64]) -> Evaluation:
        each = () if predict_stages is None else stage_powers(predict_stages, places_m)
        power = None if predict_stages is None else serving_of(predict_stages, each)
        margins, total = None, None
        if bounded and power is not None:
            margins = margins_of(*power, rows.threshold_dbm, z)
        if rows.weight is not None and power is not None:
            total = _total(connectivity_derivatives(*power, rows.threshold_dbm), rows.weight)
        gates = None if rule is None else rule.gates(places_m[None])
        parts = [
            _weighted(
                term.weight,
                _derivatives(term, situation, places_m, power, each, joint, gates, ahead, tried),
            )
            for term in problem.terms
        ]
        return Evaluation(_sum(parts, len(places_m), structure), margins, total)

    return remembering(evaluate)


def _total(chance: Derivatives, weight: NDArray[np.float64]) -> PathValue:
    """The weighted sum of the stages' probabilities."""
    return PathValue(
        float(weight @ chance.value),
        weight[:, None] * chance.gradient,
        weight[:, None] * chance.hessian,
    )


@dataclass(frozen=True, eq=False)
class _Joint:
    """One station's channel near the path, and the places where its map is wanted."""

    posterior: ChannelPosterior
    channel: LocalChannel
    grid: LocalGrid | None


def _joint_channels(situation: Situation, path_m: NDArray[np.float64]) -> list[_Joint]:
    """Of each station, where a term couples the places of a path; else none."""
    problem = situation.problem
    if not any(term.shares_places for term in problem.terms):
        return []
    region = None
    if any(term.averages_map for term in problem.terms):
        region = region_along(problem, situation.near_region, path_m)
    found: list[_Joint] = []
    for station in situation.stations:
        channel = local_channel(station, path_m, JOINT_NEIGHBOURS)
        grid = None if region is None else local_grid(channel, region.grid_m, region.weight)
        found.append(_Joint(station, channel, grid))
    return found


Part = Derivatives | PathDerivatives
"""By stage, or of the whole path."""


def _derivatives(
    term: Term,
    at: Situation,
    places_m: NDArray[np.float64],
    power: StagePower | None,
    each: Sequence[StagePower],
    joint: Sequence[_Joint],
    gates: Gates | None,
    ahead: NDArray[np.intp] | None,
    tried: NDArray[np.bool_] | None,
) -> Part:
    match term:
        case TrackingTerm() | TransmissionEnergyTerm() | CasadiTerm():
            if power is None:
                raise AssertionError("the term needs predictions of the stages")
            return stage_term_derivatives(term, at, places_m, power, each)
        case MappingTerm(form="two_layer"):
            return _steering(at, places_m, ahead)
        case MotionEnergyTerm():
            return _motion(term, at, places_m)
        case UntilConnectedTerm():
            width = LENGTH_ROUNDING_SHARE * at.problem.step_length_m
            channels = [station.channel for station in joint]
            search = at.search(term)
            beyond = _beyond(at, search, places_m[-1:], ahead)
            found = charged_distance_derivatives(channels, places_m, search, width, beyond, tried)
            return PathDerivatives(-found.value, -found.gradient, -found.hessian)
        case LearningTerm() | MappingTerm():
            first, *others = [_informed(term, at, places_m, station, gates) for station in joint]
            for other in others:
                first = PathDerivatives(
                    first.value + other.value,
                    first.gradient + other.gradient,
                    first.hessian + other.hessian,
                )
            return first
        case _:
            raise AssertionError(f"{term.kind} has no value here")


def _informed(
    term: LearningTerm | MappingTerm,
    at: Situation,
    places_m: NDArray[np.float64],
    station: _Joint,
    gates: Gates | None,
) -> PathDerivatives:
    """What the path's measurements of one station tell; those of independent ones add up."""
    channel = station.channel
    match term:
        case LearningTerm():
            criterion = at.criterion(term, station.posterior)
            return path_loss_derivatives(channel, places_m, criterion, gates)
        case MappingTerm(form="path"):
            return path_uncertainty_derivatives(channel, places_m, at.uncertainty(term), gates)
        case MappingTerm(form="information"):
            return path_information_derivatives(channel, places_m, gates=gates)
        case MappingTerm():
            if station.grid is None:
                raise AssertionError("the spatial average needs a grid")
            return average_reduction_derivatives(channel, station.grid, places_m, gates=gates)


def _steering(
    at: Situation, places_m: NDArray[np.float64], ahead: NDArray[np.intp] | None
) -> Derivatives:
    """Minus the distance of every place to the next turn of its way, of number `ahead` (N,)."""
    if ahead is None or at.steering is None:
        count = len(places_m)
        return Derivatives(np.zeros(count), np.zeros((count, 2)), np.zeros((count, 3)))
    width = LENGTH_ROUNDING_SHARE * at.problem.step_length_m
    distance = rounded_length(places_m - at.steering.turns_m[ahead], width)
    return Derivatives(-distance.value, -distance.gradient, -distance.hessian)


def _beyond(
    at: Situation, search: Search, end_m: NDArray[np.float64], ahead: NDArray[np.intp] | None
) -> Derivatives | None:
    """:meth:`Situation.beyond_m` of a path that ends at `end_m` (1, 2); None if nothing steers."""
    if ahead is None or at.steering is None:
        return None
    turn = ahead[-1:]
    width = LENGTH_ROUNDING_SHARE * at.problem.step_length_m
    leg = rounded_length(end_m - at.steering.turns_m[turn], width)
    rest = LATER * (leg.value + at.steering.rest_m[turn]) + search.beyond_m
    return Derivatives(rest, LATER * leg.gradient, LATER * leg.hessian)


def _motion(
    term: MotionEnergyTerm, at: Situation, places_m: NDArray[np.float64]
) -> PathDerivatives:
    """Minus the energy of the way; that of moving at all hardly depends on where to."""
    width = LENGTH_ROUNDING_SHARE * at.problem.step_length_m
    length = path_length_derivatives(at.position_m, places_m, width)
    scale = -term.per_metre_j_m
    return PathDerivatives(scale * length.value, scale * length.gradient, scale * length.hessian)


def _weighted(weight: float, part: Part) -> Part:
    if weight == 1.0:
        return part
    if isinstance(part, PathDerivatives):
        return PathDerivatives(weight * part.value, weight * part.gradient, weight * part.hessian)
    return Derivatives(weight * part.value, weight * part.gradient, weight * part.hessian)


def _sum(parts: list[Part], stages: int, structure: Structure) -> PathValue:
    """Everything in one value, its Hessian as `structure` has it."""
    stagewise = structure == "stagewise"
    if stagewise and len(parts) == 1:
        return PathValue(float(np.sum(parts[0].value)), parts[0].gradient, parts[0].hessian)
    value, gradient = 0.0, np.zeros((stages, 2))
    hessian = np.zeros((stages, 3)) if stagewise else np.zeros((2 * stages, 2 * stages))
    for part in parts:
        value += float(np.sum(part.value))
        gradient += part.gradient.reshape(stages, 2)
        if stagewise or isinstance(part, PathDerivatives):
            hessian += part.hessian
        else:
            add_own_blocks(hessian, part.hessian)
    return PathValue(value, gradient, _chain(hessian) if structure == "chain" else hessian)


def _chain(hessian: NDArray[np.float64]) -> NDArray[np.float64]:
    """The numbers of a chain's Hessian, from a full one that has no others; ``(7 N - 4,)``."""
    count = len(hessian) // 2
    blocks = hessian.reshape(count, 2, count, 2)
    k = np.arange(count)
    own, next_to = blocks[k, :, k], blocks[k[:-1], :, k[1:]]
    return np.concatenate([own[:, [0, 0, 1], [0, 1, 1]].ravel(), next_to.ravel()])
