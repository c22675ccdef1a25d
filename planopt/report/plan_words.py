"""A plan's verdict and certificate in words."""

from __future__ import annotations

import math

from planopt.planning.certificate import Certificate
from planopt.planning.plan import Plan, Verdict
from planopt.problems.constraints import Constraints
from planopt.report.style import spaced

MEANING = {
    Verdict.VERIFIED: "constraints hold; contact is left only where unavoidable or worth its price",
    Verdict.FEASIBLE_UNVERIFIED: "not rejected, but a part of the proof is missing",
    Verdict.VIOLATED: "a constraint does not hold",
    Verdict.NONE: "there is no plan",
}


def plan_words(plan: Plan, constraints: Constraints) -> list[str]:
    """What was found and what an independent check says of it, a line each.

    Parameters
    ----------
    plan
        The plan.
    constraints
        What it had to keep.
    """
    proof = plan.certificate
    clearance = (
        f"least clearance {proof.min_clearance_m:.3f} m of the whole swept path, "
        f"{constraints.clearance_m:g} m asked"
        if math.isfinite(proof.min_clearance_m)
        else "no obstacles to keep clear of"
    )
    lines = [
        f"verdict: {spaced(plan.verdict)} ({MEANING[plan.verdict]})",
        clearance,
        *apart_words(proof),
        f"least P(connected) {proof.min_connectivity:.3f}"
        + (f", {constraints.step_p_min:g} asked" if constraints.step_p_min > 0.0 else "")
        + f" (posterior: {proof.posterior})",
        f"motion model kept to {proof.dynamics_defect:.2g} m; "
        + (
            "not polished"
            if proof.kkt_residual is None
            else f"KKT residual of the polish {proof.kkt_residual:.2g}"
        ),
        f"cost {plan.objective:.1f} s (lattice start {plan.lattice_objective:.1f} s); "
        f"{spaced(plan.termination)} after {plan.iterations} iterations, "
        f"{1e3 * plan.wall_s:.0f} ms; rung: {spaced(plan.rung)}",
    ]
    if proof.rule is not None:
        lines.append(proof.rule.words)
    if proof.relaxed_steps:
        lines.append(
            f"the bound is not met at {len(proof.relaxed_steps)} of {len(plan.t_s) - 1} steps; "
            f"missed by at most {max(proof.relaxation_db):.2f} dB"
        )
    return [*lines, *proof.reasons, *([plan.message] if plan.message else [])]


def apart_words(proof: Certificate) -> list[str]:
    """How far a plan keeps from other robots and from what moves; nothing where nothing does."""
    parts = [
        f"{distance:.3f} m from {what}"
        for distance, what in (
            (proof.min_separation_m, "other robots"),
            (proof.min_moving_clearance_m, "moving obstacles"),
        )
        if distance is not None
    ]
    return [f"always at least {', '.join(parts)}"] if parts else []
