"""Small polishing tasks for the tests of the reach programme: a straight start, nothing about."""

import numpy as np

from planopt.planning.programme.margin_source import StageMargins
from planopt.planning.programme.polish import OutagePrice, ReachTask
from planopt.world.separation import EMPTY_OFFSET_M, SeparatingLines


def no_lines(horizon, count):
    """Empty slots only."""
    return SeparatingLines(
        normals=np.zeros((horizon, count, 2)),
        offsets=np.full((horizon, count), EMPTY_OFFSET_M),
        gaps=np.full((horizon, count), np.inf),
        piece=np.full((horizon, count), -1),
    )


def with_line(lines, segment, normal, offset_m):
    """The same with ``normal . q >= offset_m`` for a segment in its first slot."""
    lines.normals[segment, 0] = normal
    lines.offsets[segment, 0] = offset_m
    lines.gaps[segment, 0] = 0.0
    lines.piece[segment, 0] = 0
    return lines


def constant_margins(value_db):
    """Margins that are the same everywhere."""

    def margins(positions_m):
        n = len(positions_m)
        return StageMargins(np.full(n, value_db), np.zeros((n, 2)), np.zeros((n, 3)))

    return margins


def bowl_margins(centre_m, top_db):
    """``top - |q - centre|^2`` at every stage."""

    def margins(positions_m):
        away = positions_m - np.asarray(centre_m)
        return StageMargins(
            top_db - (away**2).sum(1), -2.0 * away, np.tile([-2.0, 0.0, -2.0], (len(away), 1))
        )

    return margins


def slope_margins(gradient_db_m, offset_db):
    """``gradient . q + offset`` at every stage."""

    def margins(positions_m):
        n = len(positions_m)
        value = positions_m @ np.asarray(gradient_db_m) + offset_db
        return StageMargins(value, np.tile(gradient_db_m, (n, 1)), np.zeros((n, 3)))

    return margins


def scored(margins, scores=None):
    """Margins of all stages, then their scores; certain connection unless scores are given."""
    scores = constant_margins(40.0) if scores is None else scores

    def both(positions_m):
        one, other = margins(positions_m), scores(positions_m)
        return StageMargins(
            np.concatenate([one.value, other.value]),
            np.concatenate([one.gradient, other.gradient]),
            np.concatenate([one.hessian, other.hessian]),
        )

    return both


def outage_of(horizon, price_s_m=0.0, share_before=0.0, charged=1.0):
    """A price of outage after every step, or after those that `charged` (N,) says."""
    return OutagePrice(price_s_m, share_before, np.broadcast_to(charged, horizon).astype(float))


def reach_task(horizon, line_count, **changes):
    """From the origin along x in free space: effort 0.1 s/m^2, 1 s/m to a pivot 50 m away."""
    defaults = {
        "start_m": np.zeros(2),
        "path_m": np.outer(np.arange(1, horizon + 1), [1.0, 0.0]),
        "lines": no_lines(horizon, line_count),
        "clearance_m": 0.0,
        "step_length_m": 2.0,
        "bounds_m": (-100.0, -100.0, 100.0, 100.0),
        "arrival": None,
        "pivot_m": np.array([50.0, 0.0]),
        "effort_s_m2": 0.1,
        "rate_s_m": 1.0,
        "margins": scored(constant_margins(10.0)),
        "bound_db": np.zeros(horizon),
        "outage": outage_of(horizon),
    }
    return ReachTask(**(defaults | changes))
