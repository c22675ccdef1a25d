"""Local model of the objective around an initial guess, with exact derivatives."""

from collections.abc import Sequence
from functools import cache
from typing import cast

import numpy as np

from planopt.arrays import Derivatives, Floats
from planopt.channel.kriging import LocalChannel, LocalGrid
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError
from planopt.objectives.path_derivatives import PathDerivatives, add_own_blocks
from planopt.objectives.stage_power import (
    ServingStages,
    StagePredictor,
    connectivity_derivatives,
    stage_predictor,
)
from planopt.objectives.terms.term import NearPath, Part, Structure, Term
from planopt.parts import calling, class_name, is_own, returned
from planopt.planning.programme.goal_value import (
    EvaluatePath,
    Evaluation,
    PathValue,
    margins_of,
    remembering,
)
from planopt.planning.values.context import StepContext, region_along, shares_places, structure_of
from planopt.planning.values.objective_value import RuleRows, has_step_rows, rule_rows

JOINT_NEIGHBOURS = 128
"""Number of measurements shared by all positions of a path, for terms that couple them."""


def local_value(context: StepContext, path_m: Floats, rows: RuleRows | None = None) -> EvaluatePath:
    """Return a function that evaluates objective and constraint rows of paths near a guess."""
    problem = context.problem
    structure = structure_of(problem)

    @cache
    def predictor() -> StagePredictor | ServingStages:
        return stage_predictor(context.law, path_m, problem.planner.neighbours)

    anticipated = _joint_channels(context, context.anticipated, path_m)
    channels = [channel for channel, _ in anticipated]
    if context.anticipated != context.law.posteriors:
        known = _joint_channels(context, context.law.posteriors, path_m)
        channels = [channel for channel, _ in known]
    rule = None
    if any(term.is_measured for term in problem.terms):
        rule = context.near_measuring
    # Each position keeps its turn, which remains visible after small moves.
    steering = context.steering
    ahead = None if steering is None else steering.next_turns(path_m)
    probed = None
    if any(term.steers == "connection" for term in problem.terms):
        probed = context.probing.takes(path_m)
    rows = rows if rows is not None else rule_rows(context, path_m)
    z = rows.quantile
    bounded = has_step_rows(problem)

    def evaluate(places_m: Floats) -> Evaluation:
        gates = None if rule is None else rule.gates(places_m[None])
        near = NearPath(
            context,
            places_m,
            lambda: predictor()(places_m),
            channels,
            anticipated,
            gates,
            ahead,
            probed,
        )
        margins, total = None, None
        if bounded:
            margins = margins_of(*near.stage_power, rows.threshold_dbm, z)
        if rows.weight is not None:
            chance = connectivity_derivatives(*near.stage_power, rows.threshold_dbm)
            total = _total(chance, rows.weight)
        parts = [_weighted(term.weight, _derivatives(term, near)) for term in problem.terms]
        return Evaluation(_sum(parts, len(places_m), structure), margins, total)

    evaluated = remembering(evaluate)
    if any(is_own(term) for term in problem.terms):
        # A first evaluation outside CasADi, whose callbacks lose Python exceptions.
        evaluated(path_m)
    return evaluated


def _total(chance: Derivatives, weight: Floats) -> PathValue:
    """Return the weighted sum of the stages' connection probabilities, with derivatives."""
    return PathValue(
        float(weight @ chance.value),
        weight[:, None] * chance.gradient,
        weight[:, None] * chance.hessian,
    )


def _joint_channels(
    context: StepContext, posteriors: Sequence[ChannelPosterior], path_m: Floats
) -> list[tuple[LocalChannel, LocalGrid | None]]:
    """Return each station's local channel and map; an empty list if no term needs them."""
    problem = context.problem
    if not shares_places(problem):
        return []
    region = None
    if any(term.averages_map for term in problem.terms):
        region = region_along(problem, context.near_region, path_m)
    found: list[tuple[LocalChannel, LocalGrid | None]] = []
    for station in posteriors:
        channel = LocalChannel.around(station, path_m, JOINT_NEIGHBOURS)
        grid = None if region is None else LocalGrid.of(channel, region.grid_m, region.weight)
        found.append((channel, grid))
    return found


def _derivatives(term: Term, near: NearPath) -> Part:
    """Return a term's value and derivatives for one path; the term may be user-defined."""
    with calling(term, "derivatives", key="objective.terms"):
        part = term.derivatives(near)
    if not isinstance(cast("object", part), PathDerivatives | Derivatives):
        raise InputError(
            f"{class_name(term)}.derivatives returned a {type(part).__name__}, should return "
            "PathDerivatives",
            key="objective.terms",
            remedy="return PathDerivatives(value, gradient, hessian), or derive the class from "
            "planopt.extend.OwnTerm, which needs only an expression",
        )
    if is_own(term):
        _require_shapes(term, part, len(near.places_m))
    return part


def _require_shapes(term: Term, part: Part, stages: int) -> None:
    """Raise an InputError if a user-defined term's derivatives have wrong shapes."""
    if isinstance(part, PathDerivatives):
        shapes = {"value": (), "gradient": (2 * stages,), "hessian": (2 * stages, 2 * stages)}
    else:
        shapes = {"value": (stages,), "gradient": (stages, 2), "hessian": (stages, 3)}
    for name, shape in shapes.items():
        value = getattr(part, name)
        if name == "gradient" and np.shape(value) == (stages, 2):
            shape = (stages, 2)
        words = f"{type(part).__name__} whose {name} has the shape {shape} for N = {stages}"
        key, method = "objective.terms", f"derivatives(...).{name}"
        returned(term, method, value, shape, words=words, key=key, unbounded=True)


def _weighted(weight: float, part: Part) -> Part:
    if weight == 1.0:
        return part
    if isinstance(part, PathDerivatives):
        return PathDerivatives(weight * part.value, weight * part.gradient, weight * part.hessian)
    return Derivatives(weight * part.value, weight * part.gradient, weight * part.hessian)


def _sum(parts: list[Part], stages: int, structure: Structure) -> PathValue:
    """Return the sum of the terms' values, with its Hessian in the form of `structure`."""
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


def _chain(hessian: Floats) -> Floats:
    """Return the nonzero entries (7 N - 4,) of a Hessian that couples successive stages."""
    count = len(hessian) // 2
    blocks = hessian.reshape(count, 2, count, 2)
    k = np.arange(count)
    own, next_to = blocks[k, :, k], blocks[k[:-1], :, k[1:]]
    return np.concatenate([own[:, [0, 0, 1], [0, 1, 1]].ravel(), next_to.ravel()])
