"""How each term of many ways changes with their places: slopes of what `ranked_terms` values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.path_loss_learning import theta_information
from planopt.planning.search.ranked_terms import path_form_parts
from planopt.planning.search.told_batch import ToldBatch
from planopt.planning.search.way_batch import WayBatch
from planopt.planning.search.way_slopes import (
    TINY_M,
    Pull,
    kernel_slopes,
    pull_of_legs,
    trend_of_universal,
)
from planopt.planning.worth.situation import Situation
from planopt.problems.objective import LearningTerm, MappingTerm, MotionEnergyTerm, Term

SlopedTerm = LearningTerm | MappingTerm | MotionEnergyTerm


def ranked_slope(
    term: SlopedTerm, at: Situation, told: ToldBatch, station: ChannelPosterior
) -> Pull:
    """Derivatives of what `ranked_terms` values of one station's power."""
    match term:
        case LearningTerm():
            return _learning(term, at, told, station)
        case MotionEnergyTerm():
            by_length = np.full(told.batch.shape, -term.per_metre_j_m)
            return pull_of_legs(at.position_m, told.batch.ways_m, by_length)
        case MappingTerm(form="two_layer"):
            return _steering(at, told.batch)
        case MappingTerm(form="path"):
            return _path(term, at, told)
        case MappingTerm(form="information"):
            return _information(told)
        case MappingTerm():
            return _average(told)


def has_slope(term: Term) -> bool:
    """Whether :func:`ranked_slope` knows a term."""
    return isinstance(term, SlopedTerm)


def _learning(
    term: LearningTerm, at: Situation, told: ToldBatch, station: ChannelPosterior
) -> Pull:
    """With X = S^-1 B and Z the criterion's derivative by B' S^-1 B: 2 X Z by B, -X Z X' by S."""
    criterion = at.criterion(term, station)
    x = np.linalg.solve(told.covariance, told.trend)
    before = None if criterion.kind == "T" else theta_information(station)
    by_trend = x @ criterion.slope(told.trend.transpose(0, 2, 1) @ x, before)
    by_covariance = -by_trend @ x.transpose(0, 2, 1)
    return told.pulled_back(Pull(by_covariance=by_covariance, by_trend=2.0 * by_trend))


def _steering(at: Situation, batch: WayBatch) -> Pull:
    if at.steering is None:
        return Pull()
    turns = at.steering.next_turns(batch.ways_m.reshape(-1, 2))
    offset = at.steering.turns_m[turns].reshape(batch.ways_m.shape) - batch.ways_m
    return Pull(by_place=offset / np.maximum(np.linalg.norm(offset, axis=2), TINY_M)[:, :, None])


def _by_universal(told: ToldBatch, by_universal: NDArray[np.float64]) -> Pull:
    """By S_g + B_g M B_g' (c, N, N), symmetric."""
    by_trend = trend_of_universal(told.trend, told.batch.channel, by_universal)
    return told.pulled_back(Pull(by_covariance=by_universal, by_trend=by_trend))


def _information(told: ToldBatch) -> Pull:
    """Half the inverse by S; what fills a gated measurement up is no information."""
    found = _by_universal(told, 0.5 * told.inverse)
    if told.gate is None:
        return found
    noise = told.batch.channel.parameters.multipath_std_db**2
    fills = told.gate * (noise - told.blind_db2) / told.noise_db2
    return found.plus(Pull(by_gate=fills), -1.0)


def _path(term: MappingTerm, at: Situation, told: ToldBatch) -> Pull:
    """L_ii^2 changes by L_ii^2 n_i' dS n_i, n_i row i of L^-1."""
    settings = at.uncertainty(term)
    excess, near = path_form_parts(term, at, told)
    variance = np.diagonal(told.factor, axis1=1, axis2=2) ** 2
    rows = np.linalg.inv(told.factor)
    counts = np.where(excess > 0.0, near, 0.0)
    weight = variance * counts
    found = _by_universal(told, rows.transpose(0, 2, 1) @ (weight[:, :, None] * rows))
    if told.gate is not None:
        fall = 2.0 * told.gate * (settings.threshold_db2 - told.blind_db2)
        found = found.plus(Pull(by_gate=fall * counts), -1.0)
    # A leg is in the way to its own place and to all after it.
    after = np.cumsum((excess * near)[:, ::-1], axis=1)[:, ::-1]
    legs = pull_of_legs(at.position_m, told.batch.ways_m, -settings.decay_per_m * after)
    return found.plus(legs, 1.0)


def _average(told: ToldBatch) -> Pull:
    """With X = S^-1 C: -X X' by S, 2 X by C."""
    batch, grid = told.batch, told.grid
    distance, kernel, across = batch.across
    x = (told.inverse.astype(np.float32) @ told.across).astype(np.float32)
    by_covariance = -(x @ x.transpose(0, 2, 1)).astype(np.float64)
    by_gate = None
    if told.gate is not None:
        by_gate = 2.0 * (x * across).sum(axis=2, dtype=np.float64)
        x *= told.gate.astype(np.float32)[:, :, None]
    by_across = (2.0 * x * grid.root_weight.astype(np.float32)).reshape(kernel.shape)
    by_trend = (by_across @ grid.trend.astype(np.float32)).astype(np.float64)
    by_trend = by_trend.reshape(*batch.shape, 2) @ batch.channel.theta_covariance
    by_phi = np.zeros_like(batch.solved)
    by_phi -= (by_across @ grid.solved.T.astype(np.float32)).reshape(by_phi.shape)
    by_place = kernel_slopes(batch.ways_m, grid.positions_m, batch, by_across, distance, kernel)
    found = _by_universal(told, by_covariance)
    return found.plus(Pull(by_place, None, by_trend, by_phi, by_gate), 1.0)
