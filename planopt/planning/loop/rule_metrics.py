"""What a run kept of its rule of connectivity in truth: the worst of its robots."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planopt.planning.history import data_of_steps_mbit
from planopt.planning.loop.metrics import longest_outage_m
from planopt.planning.loop.run import StepLog
from planopt.problems.problem import Problem


def rule_metrics(problem: Problem, logs: Sequence[StepLog]) -> dict[str, float]:
    """The metric of the problem's rule by name, of the worst robot; empty where it has none.

    ``stated_times_connected``: share of the stated times driven through that were connected (one
    where there are none). ``least_connected_share``: of the steps, for the average.
    ``longest_outage_s``. ``data_mbit``: delivered by the deadline.
    """
    rule, step_s = problem.constraints.rule, problem.planner.step_s
    connected = [log.connected[1:] for log in logs]
    match rule.connectivity:
        case "stated_times":
            stated = np.unique(np.rint(np.array(rule.connected_times_s) / step_s)).astype(np.intp)
            kept = [now[stated[stated <= len(now)] - 1] for now in connected]
            least = min(float(now.mean()) if now.size else 1.0 for now in kept)
            return {"stated_times_connected": least}
        case "average":
            least = min(float(now.mean()) if now.size else 1.0 for now in connected)
            return {"least_connected_share": least}
        case "outage":
            longest = max(longest_outage_m(np.full(len(now), step_s), now) for now in connected)
            return {"longest_outage_s": longest}
        case "data":
            delivered = [float(data_of_steps_mbit(problem, 0, len(now)) @ now) for now in connected]
            return {"data_mbit": min(delivered)}
        case _:
            return {}
