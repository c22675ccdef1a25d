"""Verdict and certificate of a plan in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

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
    """Return the plan and the verdict of the independent verifier in words, a line each."""
    proof = plan.certificate
    clearance = (
        f"least clearance {proof.min_clearance_m:.3f} m along the swept path, "
        f"{constraints.clearance_m:g} m required"
        if math.isfinite(proof.min_clearance_m)
        else "no obstacles to keep clear of"
    )
    required = f", {constraints.step_p_min:g} required" if constraints.step_p_min > 0.0 else ""
    residual = (
        "not refined"
        if proof.kkt_residual is None
        else f"KKT residual of the refinement {proof.kkt_residual:.2g}"
    )
    lines = [
        f"verdict: {spaced(plan.verdict)} ({MEANING[plan.verdict]})",
        clearance,
        *_distance_words(proof),
        f"least P(connected) {proof.min_connectivity:.3f}{required} (posterior: {proof.posterior})",
        f"motion model satisfied to {proof.dynamics_defect:.2g} m; {residual}",
        f"cost {plan.objective:.1f} s (lattice start {plan.lattice_objective:.1f} s); "
        f"{spaced(plan.termination)} after {plan.iterations} iterations, "
        f"{1e3 * plan.wall_s:.0f} ms; fallback: {spaced(plan.rung)}",
    ]
    if proof.rule is not None:
        lines.append(proof.rule.words)
    if proof.relaxed_steps:
        lines.append(
            f"the bound is not met at {len(proof.relaxed_steps)} of {len(plan.t_s) - 1} steps; "
            f"missed by at most {max(proof.relaxation_db):.2f} dB"
        )
    return [*lines, *proof.reasons, *([plan.message] if plan.message else [])]


def team_words(plans: Sequence[Plan]) -> list[str]:
    """Return each robot's verdict in words, a few lines each."""
    lines: list[str] = []
    for plan in plans:
        proof = plan.certificate
        clearance = (
            f"least clearance {proof.min_clearance_m:.2f} m"
            if math.isfinite(proof.min_clearance_m)
            else "no obstacles"
        )
        lines += [
            f"{plan.robot}: {spaced(plan.verdict)}, {clearance}, "
            f"least P(connected) {proof.min_connectivity:.3f}",
            *(f"    {words}" for words in _distance_words(proof)),
            f"    objective {plan.objective:.4g} (best start {plan.lattice_objective:.4g}); "
            f"fallback {spaced(plan.rung)}, {1e3 * plan.wall_s:.0f} ms",
            *(f"    {reason}" for reason in proof.reasons[:2]),
        ]
    return lines


def _distance_words(proof: Certificate) -> list[str]:
    """Return the distance a plan keeps from robots and moving obstacles, if there are any."""
    parts = [
        f"{distance:.3f} m from {kind}"
        for distance, kind in (
            (proof.min_separation_m, "other robots"),
            (proof.min_moving_clearance_m, "moving obstacles"),
        )
        if distance is not None
    ]
    return [f"always at least {', '.join(parts)}"] if parts else []
