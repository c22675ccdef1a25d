"""Verification of a plan: clearance, motion and connectivity, from problem and belief alone.

A step to a goal may violate p_min if no path found by the verifier is cheaper by more than a
tolerance; a step for a sum of terms, if no position reachable by then satisfies p_min
(:mod:`planopt.planning.proof.searches`). Bounded slack replaces these exceptions.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.kriging import Prediction, bound_margin_db, connection_probability
from planopt.planning.certificate import Certificate, RuleResult, plan_message
from planopt.planning.plan import History, Plan, Rung, Termination, Verdict
from planopt.planning.proof.motion import is_at_goal, swept_motion, verify_apart, verify_motion
from planopt.planning.proof.rule import (
    PathCase,
    VerifierContext,
    certified_prediction,
    rule_of,
    rule_reasons,
    search_power,
    search_prediction,
    whole_plan_result,
)
from planopt.planning.proof.searches import (
    PricedPath,
    best_margins_by_step,
    build_goal_grid,
    goal_costs,
    price_path,
)
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB, STANDSTILL_M
from planopt.problems.problem import Problem, may_reach_from, outage_share
from planopt.robots.dynamics import Drive

COST_TOLERANCE = 0.05
"""Relative excess cost over the cheapest path found, allowed for a plan and for a run."""
COST_LEEWAY_STEPS = 2.0
"""Additional allowance for the grid's resolution, in longest steps out of contact."""


@dataclass(frozen=True)
class StepsFinding:
    """Verifier's findings on p_min at single steps, with field names of the certificate."""

    relaxed_steps: tuple[int, ...] = ()
    relaxation_db: tuple[float, ...] = ()
    best_margin_db: tuple[float, ...] = ()
    path_cost_m: float | None = None
    best_cost_m: float | None = None
    step_cost_m: float | None = None
    step_excess_m: float | None = None
    reasons: tuple[str, ...] = ()
    rule: RuleResult | None = None  # None for the default rule
    is_compared: bool = True  # Whether a path exists for the cost comparison


def is_priced(problem: Problem) -> bool:
    """Return whether single steps may violate p_min at the outage price."""
    return problem.has_goal and problem.constraints.rule.is_plain


def verify_single_steps(
    context: VerifierContext, positions_m: Floats, power: Prediction
) -> StepsFinding:
    """Return the findings on p_min at the constrained steps of a path (N + 1, 2)."""
    problem = context.problem
    constraints, radio = problem.constraints, problem.stations[0]
    mean, deviation = power.mean_db[1:], power.deviation_db[1:]
    # Without p_min, every margin is infinite.
    margins = bound_margin_db(mean, deviation, radio.threshold_dbm, constraints.p_min)
    counted = rule_of(problem).counted(context.history, len(margins))
    missed = np.nonzero((margins < -MARGIN_TOLERANCE_DB) & counted)[0] + 1
    steps = tuple(missed.tolist())
    relaxation = tuple(float(-margins[step - 1]) for step in missed)
    result = _result(problem, counted, relaxation)
    if constraints.rule.slack_max_db is not None:
        reasons = _beyond_slack(problem, missed, relaxation)
        return StepsFinding(steps, relaxation, reasons=tuple(reasons), rule=result)
    if missed.size == 0:
        return StepsFinding(rule=result)
    if is_priced(problem):
        priced, best_margin_db = _priced(context, positions_m)
        return StepsFinding(
            steps,
            relaxation,
            path_cost_m=priced.cost_m,
            best_cost_m=priced.best_m,
            step_cost_m=priced.step_m,
            step_excess_m=priced.excess_m,
            reasons=tuple(_too_dear(problem, context.history, priced, best_margin_db)),
            is_compared=priced.is_compared,
            rule=result,
        )
    law = context.law
    best = context.best_margins(
        steps,
        lambda: best_margins_by_step(
            context.index,
            problem.workspace.bounds_m,
            # Known connections do not count: a robot need not return to where a packet arrived.
            lambda places_m: law.margin_of_db(law.predicted(places_m, search_power)),
            context.position_m,
            problem.step_length_m,
            missed,
            constraints.clearance_m,
            may_reach_from(problem, context.state),
        ),
    )
    reasons = [
        f"connectivity at step {step} is below constraints.p_min {constraints.p_min:g}, "
        f"although a place with {margin:.2f} dB to spare is within reach"
        for step, margin in zip(missed, best, strict=True)
        if margin >= 0.0
    ][:1]
    count = int(counted.sum())
    if len(missed) == count:
        reasons.append(
            f"constraints.p_min {constraints.p_min:g} is met at none of the {count} steps"
            f"{'' if count == len(margins) else ' where it is required'}, "
            f"the best reachable position has a margin of {max(best):.2f} dB"
        )
    return StepsFinding(steps, relaxation, best, reasons=tuple(reasons), rule=result)


def _result(problem: Problem, counted: Mask, relaxation_db: tuple[float, ...]) -> RuleResult | None:
    """Return the number of steps that satisfy p_min as a rule result; None for the default rule."""
    rule = problem.constraints.rule
    if rule.is_plain:
        return None
    kept = int(counted.sum()) - len(relaxation_db)
    return RuleResult(
        rule.connectivity,
        float(kept),
        float(counted.sum()),
        "steps",
        "p_min at each required step",
        # Without allowed slack, a shortfall does not count as slack.
        0.0 if rule.slack_max_db is None else max(relaxation_db, default=0.0),
    )


def _beyond_slack(problem: Problem, missed: Indices, relaxation_db: tuple[float, ...]) -> list[str]:
    """Return the reasons why steps violate p_min beyond the slack; empty if none does."""
    limit = problem.constraints.rule.slack_max_db or 0.0
    return [
        f"connectivity at step {step} misses constraints.p_min {problem.constraints.p_min:g} by "
        f"{missing:.4g} dB, constraints.slack_max_db is {limit:g}"
        for step, missing in zip(missed.tolist(), relaxation_db, strict=True)
        if missing > limit + MARGIN_TOLERANCE_DB
    ]


def _priced(context: VerifierContext, positions_m: Floats) -> tuple[PricedPath, float]:
    """Return the costs of a path (N + 1, 2), and the best margin found in the workspace."""
    problem = context.problem
    threshold, p_min = problem.stations[0].threshold_dbm, problem.constraints.p_min

    def contact_at(places_m: Floats) -> tuple[Floats, Floats]:
        power = search_prediction(context.law, places_m)
        margin = bound_margin_db(power.mean_db, power.deviation_db, threshold, p_min)
        chance = connection_probability(power.mean_db, power.deviation_db, threshold)
        everywhere = problem.reach.charges_everywhere
        return outage_share(chance, margin < -MARGIN_TOLERANCE_DB, everywhere), margin

    price = problem.reach.outage_price
    grid, costs = context.goal_costs(
        lambda: build_goal_grid(problem, context.index),
        lambda grid: goal_costs(grid, contact_at, price),
    )
    share = contact_at(positions_m)[0]
    priced = price_path(grid, context.index, costs, price, positions_m, share)
    return priced, costs.best_margin_db


def _too_dear(
    problem: Problem, history: History, priced: PricedPath, best_margin_db: float
) -> list[str]:
    """Return the reason if a path or run costs too much, or if no position satisfies p_min."""
    p_min, price = problem.constraints.p_min, problem.reach.outage_price
    if best_margin_db < -MARGIN_TOLERANCE_DB:
        return [
            f"constraints.p_min {p_min:g} is met nowhere in the workspace, "
            f"the best position found misses it by {-best_margin_db:.2f} dB"
        ]
    leeway = COST_LEEWAY_STEPS * problem.step_length_m * (1.0 + price)
    spent = history.crossing_excess_m + priced.excess_m
    allowed = COST_TOLERANCE * (history.crossing_cost_m + priced.step_m) + leeway
    if spent > allowed:
        return [
            f"steps are below constraints.p_min {p_min:g}, and those of the run so far have cost "
            f"{spent:.1f} m more than the cheapest paths found at objective.outage_price "
            f"{price:g}, {allowed:.1f} m are allowed"
        ]
    # Without a path to compare with, nothing is proven.
    within = priced.cost_m <= (1.0 + COST_TOLERANCE) * priced.best_m + leeway
    if within or not priced.is_compared:
        return []
    return [
        f"steps are below constraints.p_min {p_min:g}, and the plan costs {priced.cost_m:.1f} m to "
        f"the goal at objective.outage_price {price:g}, although a path of {priced.best_m:.1f} m "
        "was found"
    ]


UNCOMPARED = (
    "steps are below constraints.p_min, and the verifier's grid, half a step wide, has no path "
    "from here to the goal to compare the plan with"
)
STANDING = "the plan stands still short of the goal without a moving obstacle in front of it"


@dataclass(frozen=True)
class Judgement:
    """Findings of the verifier on a path, with the predicted power.

    Attributes
    ----------
    certificate, verdict
        Margins of all constraints, and the verdict that follows from them.
    power
        Predicted power at the robot's position and at every position of the path; None if the
        path is not finite.
    sound
        Whether the limits on clearance, bounds, dynamics and distance to moving obstacles hold.
    """

    certificate: Certificate
    verdict: Verdict
    power: Prediction | None
    sound: bool = False

    def plan(
        self,
        problem: Problem,
        positions_m: Floats,  # (N + 1, 2)
        objective: float,
        lattice_objective: float,
        rung: Rung,
        termination: Termination,
        drive: Drive | None,
    ) -> Plan:
        """Return the path as a plan with these findings."""
        if self.power is None:
            raise AssertionError("a path that is not finite is never released")
        mean, deviation = self.power.mean_db, self.power.deviation_db
        threshold = problem.stations[0].threshold_dbm
        return Plan(
            robot=problem.robots[0].name,
            t_s=problem.planner.step_s * np.arange(len(positions_m), dtype=np.float64),
            positions_m=positions_m,
            mean_dbm=mean,
            deviation_db=deviation,
            connectivity=connection_probability(mean, deviation, threshold),
            objective=objective,
            lattice_objective=lattice_objective,
            termination=termination,
            verdict=self.verdict,
            rung=rung,
            certificate=self.certificate,
            message=plan_message(self.certificate, positions_m),
            sense=problem.sense,
            drive=drive,
        )


def verify(
    context: VerifierContext,
    positions_m: Floats,
    kkt_residual: float | None = None,  # Copied into the certificate
    drive: Drive | None = None,  # None for the single integrator
) -> Judgement:
    """Return the verifier's findings on a path (N + 1, 2), the robot's position first."""
    problem = context.problem
    if not np.isfinite(positions_m).all():
        broken = Certificate(0.0, 0.0, float("inf"), kkt_residual, "exact", reasons=("not finite",))
        return Judgement(broken, Verdict.VIOLATED, None)
    motion = verify_motion(problem, context.index, context.state, positions_m, drive)
    reasons = list(motion.reasons)
    swept = swept_motion(problem, positions_m, drive)
    apart = verify_apart(context.moving, swept, len(positions_m) - 1)
    reasons += apart.reasons

    power, kind = certified_prediction(context.law, positions_m)
    planned = Prediction(power.mean_db[1:], power.deviation_db[1:])
    probability = connection_probability(
        planned.mean_db, planned.deviation_db, problem.stations[0].threshold_dbm
    )
    if problem.constraints.rule.by_step:
        steps = verify_single_steps(context, positions_m, power)
    else:
        result = whole_plan_result(PathCase(context, positions_m, planned))
        steps = StepsFinding(reasons=tuple(rule_reasons(problem, result)), rule=result)
    reasons += steps.reasons
    found: dict[str, Any] = {key.name: getattr(steps, key.name) for key in fields(StepsFinding)}
    is_compared = found.pop("is_compared")
    found["reasons"] = tuple(reasons)
    certificate = Certificate(
        min_clearance_m=motion.clearance_m,
        min_connectivity=float(probability.min()),
        dynamics_defect=motion.defect_m,
        kkt_residual=kkt_residual,
        posterior=kind,
        min_separation_m=apart.min_separation_m,
        min_moving_clearance_m=apart.min_moving_clearance_m,
        **found,
    )
    verdict = Verdict.VIOLATED if reasons else Verdict.VERIFIED
    missing = [
        *([UNCOMPARED] if not is_compared else []),
        *([STANDING] if _gets_nowhere(context, positions_m, drive) else []),
    ]
    if missing and not reasons:
        certificate = replace(certificate, reasons=tuple(missing))
        verdict = Verdict.FEASIBLE_UNVERIFIED
    sound = not motion.reasons and not apart.reasons
    return Judgement(certificate, verdict, power, sound)


def _gets_nowhere(context: VerifierContext, positions_m: Floats, drive: Drive | None) -> bool:
    """Return whether a robot waits short of its goal although no obstacle moves."""
    problem = context.problem
    if not problem.has_goal or len(context.moving) or is_at_goal(problem, positions_m[0]):
        return False
    track = positions_m if drive is None else drive.states
    return bool(np.abs(track - track[0]).max() <= STANDSTILL_M)
