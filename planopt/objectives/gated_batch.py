"""Measurements that count in part, with derivatives: what a solver sees of the measuring rule.

A measurement of gate g in [0, 1] is one of g times what the channel gives there, with noise that
fills its variance up to that of measuring blindly, kappa = xi^2 + omega^2:

    S_g = G (S - kappa I) G + kappa I,    B_g = G B,    G = diag(g).

With g = 1 that is the measurement itself, with g = 0 one that tells nothing, and every objective of
S and B stays what it is. Each gate is a third coordinate of its place, on which row and column i of
S_g depend as they do on the place; :func:`by_places` then puts in how gates change with the places.
"""

from __future__ import annotations

import numpy as np

from planopt.channel.parameters import ChannelParameters
from planopt.objectives.batch_derivatives import BatchDerivatives, PathDerivatives, Rows
from planopt.objectives.measuring import Gates


def blind_variance_db2(parameters: ChannelParameters) -> float:
    """kappa, the variance of a measurement that tells nothing."""
    return parameters.shadow_std_db**2 + parameters.multipath_std_db**2


def gated_batch(
    batch: BatchDerivatives, gates: Gates | None, parameters: ChannelParameters
) -> BatchDerivatives:
    """S_g and B_g of a path; `batch` itself without gates.

    Parameters
    ----------
    batch
        S and B.
    gates
        Of the single path.
    parameters
        Of the channel.
    """
    if gates is None:
        return batch
    gate, steps = gates.value[0], len(batch.covariance)
    both = gate[:, None] * gate
    blind = blind_variance_db2(parameters) * np.eye(steps)
    told = batch.covariance - blind
    first = batch.first.reshape(steps, 2, steps)
    wide_first = np.empty((steps, 3, steps))
    wide_first[:, :2] = both[:, None] * first
    wide_first[:, 2] = gate * told
    mixed = np.empty((steps, 3, steps, 3))
    mixed[:, :2, :, :2] = both[:, None, :, None] * batch.mixed.reshape(steps, 2, steps, 2)
    by_gate = gate[:, None, None] * first
    mixed[:, :2, :, 2] = by_gate
    mixed[:, 2, :, :2] = by_gate.transpose(2, 0, 1)
    mixed[:, 2, :, 2] = told
    second = np.zeros((steps, 6, steps))
    second[:, :3] = both[:, None] * batch.second
    second[:, 3:5] = gate * first
    return BatchDerivatives(
        both * told + blind,
        wide_first.reshape(3 * steps, steps),
        mixed.reshape(3 * steps, 3 * steps),
        second,
        gated_rows(batch.trend, gates),
        batch.phi,
    )


def gated_rows(rows: Rows, gates: Gates | None) -> Rows:
    """G times rows that depend on single places; the rows themselves without gates."""
    if gates is None:
        return rows
    gate, steps = gates.value[0], len(rows.value)
    plain = rows.first.reshape(steps, 2, -1)
    first = np.concatenate([gate[:, None, None] * plain, rows.value[:, None]], axis=1)
    second = [gate[:, None, None] * rows.second, plain, np.zeros_like(plain[:, :1])]
    return Rows(
        gate[:, None] * rows.value,
        first.reshape(3 * steps, -1),
        np.concatenate(second, axis=1),
    )


def by_places(found: PathDerivatives, gates: Gates | None) -> PathDerivatives:
    """From derivatives by places and gates, (3 h,) and (3 h, 3 h), to those by places alone."""
    if gates is None:
        return found
    steps = len(found.gradient) // 3
    gradient = found.gradient.reshape(steps, 3)
    place = (3 * np.arange(steps)[:, None] + [0, 1]).ravel()
    gate = 3 * np.arange(steps) + 2
    jacobian = gates.jacobian()
    crossed = found.hessian[np.ix_(place, gate)] @ jacobian
    hessian = found.hessian[np.ix_(place, place)] + crossed + crossed.T
    hessian += jacobian.T @ found.hessian[np.ix_(gate, gate)] @ jacobian
    hessian += gates.curvature(gradient[:, 2])
    return PathDerivatives(
        found.value, gradient[:, :2].ravel() + gradient[:, 2] @ jacobian, hessian
    )
