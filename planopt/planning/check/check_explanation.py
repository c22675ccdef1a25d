"""Judge what a saved plan says would help: it must fit the problem, and the limits found again.

Whether the problem solved again was verified (`verified`) only planning again could tell; it is
taken as it stands.
"""

from __future__ import annotations

from collections.abc import Sequence

from planopt.channel.posterior import ChannelPosterior
from planopt.planning.check.agreement import EXACT, PREDICTION
from planopt.planning.explain.explanation import Relaxation
from planopt.planning.explain.reach_limits import best_margin_db, best_probability, least_horizon
from planopt.planning.free_space import is_joined
from planopt.planning.plan import Plan, Verdict
from planopt.problems.problem import Problem

OBSTACLE = "world.obstacles ("


def explanation_faults(
    problem: Problem,
    posteriors: Sequence[ChannelPosterior],
    plan: Plan,
    explanation: Sequence[Relaxation],
) -> list[str]:
    """What in the explanation of one robot's plan cannot be so.

    Parameters
    ----------
    problem
        With this robot alone.
    posteriors, plan
        What is believed of each station, and the plan as it was judged again.
    explanation
        Every change that is said to help this robot.
    """
    if plan.verdict is Verdict.VERIFIED:
        return ["explanation: says what would help, but the plan is verified"] * bool(explanation)
    certificate, start = plan.certificate, plan.positions_m[0]
    nowhere = len(certificate.relaxed_steps) == len(plan.positions_m) - 1
    faults: list[str] = []
    for one in explanation:
        key, relaxed = one.constraint, one.relaxed_value
        asked = _asked(problem).get(key)
        if asked is None or relaxed is None:
            faults.append(f"explanation: {key} does not concern a plan that there is")
            continue
        if one.value != asked[0] or one.unit != asked[1] or one.shortfall_unit != "dB":
            faults.append(f"explanation: {key} is {asked[0]:g} {asked[1]}".rstrip())
        if one.stages != certificate.relaxed_steps:
            faults.append(f"explanation: stages of {key} are not the certificate's relaxed_steps")
        short = max(certificate.relaxation_db, default=0.0)
        if nowhere:
            short = max(-best_margin_db(problem, posteriors, start), 0.0)
        if one.shortfall is None or abs(one.shortfall - short) > PREDICTION:
            faults.append(f"explanation: the shortfall of {key} is {short:.6g} dB")
        limit = asked[0] - short + PREDICTION
        if key == "constraints.p_min":
            limit = best_probability(problem, posteriors, start) + PREDICTION if nowhere else 1.0
        beyond = relaxed > limit or relaxed >= asked[0]
        if key == "planner.horizon":
            least = least_horizon(problem, posteriors, start)
            beyond = least is None or relaxed < least
        if beyond:
            faults.append(f"explanation: {key} {relaxed:g} does not help")
    return faults


def no_way_faults(problem: Problem, explanation: Sequence[Relaxation]) -> list[str]:
    """The same where no way leads to the goal."""
    faults: list[str] = []
    asked = problem.constraints.clearance_m
    for one in explanation:
        key, relaxed = one.constraint, one.relaxed_value
        if key == "constraints.clearance_m" and relaxed is not None:
            helps = 0.0 <= relaxed < asked and is_joined(problem, relaxed)
            fits = one.value == asked and _near(one.shortfall, asked - relaxed)
        elif key == "planner.step_s" and relaxed is not None:
            helps = 0.0 < relaxed < problem.planner.step_s and is_joined(problem, asked)
            fits = one.value == problem.planner.step_s and _near(
                one.shortfall, problem.planner.step_s - relaxed
            )
        else:
            named = [o for o in problem.workspace.obstacles if key == f"{OBSTACLE}{o.name})"]
            helps = any(is_joined(problem, asked, without=obstacle) for obstacle in named)
            fits = one.value is None and relaxed is None and one.shortfall is None
        if not helps:
            faults.append(f"explanation: {key} does not open a way to the goal")
        if not fits or one.stages or one.robot != problem.robots[0].name:
            faults.append(f"explanation: {key} does not fit the problem")
    return faults


def _near(said: float | None, found: float) -> bool:
    return said is not None and abs(said - found) <= EXACT


def _asked(problem: Problem) -> dict[str, tuple[float, str]]:
    """What a plan can be explained by, with its unit."""
    return {
        "constraints.p_min": (problem.constraints.p_min, ""),
        "stations[0].threshold_dbm": (problem.stations[0].threshold_dbm, "dBm"),
        "planner.horizon": (problem.planner.horizon, ""),
    }
