"""Small polishing tasks for the tests of the reach programme: a straight start, nothing about."""

from dataclasses import fields, replace

import numpy as np

from planopt.arrays import Derivatives
from planopt.planning.programme.goal_value import Evaluation, PricedCharge
from planopt.planning.programme.path_nlp import GOAL, build_path_nlp
from planopt.planning.programme.solver import PathShape
from planopt.planning.refinement import PathTask
from planopt.world import empty_lines


def no_lines(horizon, count):
    return empty_lines(horizon, count)


def with_line(lines, segment, normal, offset_m):
    """The same with ``normal . q >= offset_m`` for a segment in its first slot."""
    lines.normals[segment, 0] = normal
    lines.offsets[segment, 0] = lines.start_offsets[segment, 0] = offset_m
    lines.gaps[segment, 0] = 0.0
    lines.piece[segment, 0] = 0
    return lines


def constant_margins(value_db):
    def margins(positions_m):
        n = len(positions_m)
        return Derivatives(np.full(n, value_db), np.zeros((n, 2)), np.zeros((n, 3)))

    return margins


def bowl_margins(centre_m, top_db):
    """``top - |q - centre|^2`` at every stage."""

    def margins(positions_m):
        away = positions_m - np.asarray(centre_m)
        return Derivatives(
            top_db - (away**2).sum(1), -2.0 * away, np.tile([-2.0, 0.0, -2.0], (len(away), 1))
        )

    return margins


def slope_margins(gradient_db_m, offset_db):
    """``gradient . q + offset`` at every stage."""

    def margins(positions_m):
        n = len(positions_m)
        value = positions_m @ np.asarray(gradient_db_m) + offset_db
        return Derivatives(value, np.tile(gradient_db_m, (n, 1)), np.zeros((n, 3)))

    return margins


def scored(margins, scores=None):
    """Margins and scores of all stages; certain connection unless scores are given."""
    scores = constant_margins(40.0) if scores is None else scores
    return lambda positions_m: Evaluation(None, margins(positions_m), scores=scores(positions_m))


def outage_of(horizon, price_s_m=0.0, share_before=0.0, charged=1.0):
    """A price of outage after every step, or after those that `charged` (N,) says."""
    charged = np.broadcast_to(charged, horizon).astype(float)
    return {"price_s_m": price_s_m, "share_before": share_before, "charged": charged}


OF_CHARGE = {field.name for field in fields(PricedCharge)}


def goal_nlp(horizon, lines, method="ipopt"):
    """The programme for the cost of a goal, as the planner builds it."""
    shape = PathShape(
        horizon, lines, "stagewise", bounded=True, slacked=False, charged=True, valued=False
    )
    return build_path_nlp(shape, method, options=GOAL)


def changed(task, margins=None, outage=None, **changes):
    """The task with other fields, of its goal cost as well."""
    of_charge = {name: changes.pop(name) for name in OF_CHARGE & set(changes)}
    charge = replace(task.charge, **of_charge, **(outage or {}))
    return replace(task, evaluate=margins or task.evaluate, charge=charge, **changes)


def reach_task(horizon, line_count, **changes):
    """From the origin along x in free space: effort 0.1 s/m^2, 1 s/m to a pivot 50 m away."""
    task = PathTask(
        start_m=np.zeros(2),
        path_m=np.outer(np.arange(1, horizon + 1), [1.0, 0.0]),
        lines=no_lines(horizon, line_count),
        clearance_m=0.0,
        step_length_m=2.0,
        bounds_m=(-100.0, -100.0, 100.0, 100.0),
        evaluate=scored(constant_margins(10.0)),
        scale=1.0,
        bound=np.zeros(horizon),
        charge=PricedCharge(np.array([50.0, 0.0]), 0.1, 1.0, **outage_of(horizon)),
    )
    return changed(task, **changes)
