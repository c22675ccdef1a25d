"""How each term of many ways changes with their places: slopes of what `ranked_terms` values."""

from __future__ import annotations

import numpy as np

from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.path_loss_learning import theta_information
from planopt.planning.search.ranked_terms import path_form_parts
from planopt.planning.search.way_batch import WayBatch
from planopt.planning.search.way_slopes import (
    TINY_M,
    Pull,
    kernel_slopes,
    pull_of_legs,
    pull_of_universal,
)
from planopt.planning.worth.situation import Situation
from planopt.problems.objective import LearningTerm, MappingTerm, MotionEnergyTerm, Term

SlopedTerm = LearningTerm | MappingTerm | MotionEnergyTerm


def ranked_slope(
    term: SlopedTerm, at: Situation, batch: WayBatch, station: ChannelPosterior
) -> Pull:
    """Derivatives of what `ranked_terms` values of one station's power."""
    match term:
        case LearningTerm():
            return _learning(term, at, batch, station)
        case MotionEnergyTerm():
            by_length = np.full(batch.shape, -term.per_metre_j_m)
            return pull_of_legs(at.position_m, batch.ways_m, by_length)
        case MappingTerm(form="two_layer"):
            return _steering(at, batch)
        case MappingTerm(form="path"):
            return _path(term, at, batch)
        case MappingTerm(form="information"):
            return pull_of_universal(batch, 0.5 * batch.inverse)
        case MappingTerm():
            return _average(batch)


def has_slope(term: Term) -> bool:
    """Whether :func:`ranked_slope` knows a term."""
    return isinstance(term, SlopedTerm)


def _learning(
    term: LearningTerm, at: Situation, batch: WayBatch, station: ChannelPosterior
) -> Pull:
    """With X = S^-1 B and Z the criterion's derivative by B' S^-1 B: 2 X Z by B, -X Z X' by S."""
    criterion = at.criterion(term, station)
    x = np.linalg.solve(batch.covariance, batch.trend)
    before = None if criterion.kind == "T" else theta_information(station)
    by_trend = x @ criterion.slope(batch.trend.transpose(0, 2, 1) @ x, before)
    return Pull(by_covariance=-by_trend @ x.transpose(0, 2, 1), by_trend=2.0 * by_trend)


def _steering(at: Situation, batch: WayBatch) -> Pull:
    if at.steering_m is None:
        return Pull()
    offset = at.steering_m - batch.ways_m
    return Pull(by_place=offset / np.maximum(np.linalg.norm(offset, axis=2), TINY_M)[:, :, None])


def _path(term: MappingTerm, at: Situation, batch: WayBatch) -> Pull:
    """L_ii^2 changes by L_ii^2 n_i' dS n_i, n_i row i of L^-1."""
    decay = at.uncertainty(term).decay_per_m
    variance, excess, near = path_form_parts(term, at, batch)
    rows = np.linalg.inv(batch.factor)
    weight = np.where(excess > 0.0, variance * near, 0.0)
    found = pull_of_universal(batch, rows.transpose(0, 2, 1) @ (weight[:, :, None] * rows))
    # A leg is in the way to its own place and to all after it.
    after = np.cumsum((excess * near)[:, ::-1], axis=1)[:, ::-1]
    return found.plus(pull_of_legs(at.position_m, batch.ways_m, -decay * after), 1.0)


def _average(batch: WayBatch) -> Pull:
    """With X = S^-1 C: -X X' by S, 2 X by C."""
    grid, channel = batch.required_grid, batch.channel
    distance, kernel, across = batch.across
    x = (batch.inverse.astype(np.float32) @ across).astype(np.float32)
    by_covariance = -(x @ x.transpose(0, 2, 1)).astype(np.float64)
    by_across = (2.0 * x * grid.root_weight.astype(np.float32)).reshape(kernel.shape)
    by_trend = (by_across @ grid.trend.astype(np.float32)).astype(np.float64)
    by_phi = np.zeros_like(batch.solved)
    by_phi -= (by_across @ grid.solved.T.astype(np.float32)).reshape(by_phi.shape)
    by_place = kernel_slopes(batch.ways_m, grid.positions_m, batch, by_across, distance, kernel)
    found = pull_of_universal(batch, by_covariance)
    by_trend = by_trend.reshape(*batch.shape, 2) @ channel.theta_covariance
    return found.plus(Pull(by_place=by_place, by_trend=by_trend, by_phi=by_phi), 1.0)
