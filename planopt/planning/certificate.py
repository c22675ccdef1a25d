"""What the verifier computed of a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from planopt.planning.rule_result import RuleResult


@dataclass(frozen=True)
class Certificate:
    """What the verifier computed, by code that shares nothing with the solver.

    Attributes
    ----------
    min_clearance_m
        Least distance between the swept path and any obstacle, exact; infinite without obstacles.
    min_connectivity
        Least probability of connection over the planned steps, from the posterior named below.
    dynamics_defect
        Largest violation of the motion model and the input set, in metres.
    kkt_residual
        Unscaled KKT residual of the polished point; None where nothing was polished.
    posterior
        ``exact`` or ``neighbours:512``.
    relaxed_steps
        Steps (1 is the first) at which the bound is not met.
    relaxation_db
        By how many dB at each of them the bound is missed.
    best_margin_db
        At each of them, the best margin (dB, negative) found over every place that the robot
        could reach by then: negative is the proof that the bound could not be met.
    path_cost_m, best_cost_m
        On the way to a goal, where the bound is missed: what the plan and the rest of the way cost
        at the outage price, and what the cheapest path costs that the verifier finds, in metres;
        else None.
    step_cost_m, step_excess_m
        There as well: what the first step costs, and by how much the cheapest path is dearer after
        it than before, that included. A run's sums of both are bounded by its allowance.
    reasons
        Why the verdict is not ``verified``; empty if it is.
    min_separation_m
        Least distance from any other robot at equal times, all the way; None where no separation
        is asked or there is no other robot. Those that have not planned yet are where their last
        plans lead.
    min_moving_clearance_m
        Least distance from any moving obstacle at equal times, all the way, negative inside one;
        None without one.
    rule
        What is achieved of a rule of connectivity other than p_min at each step where possible.
    """

    min_clearance_m: float
    min_connectivity: float
    dynamics_defect: float
    kkt_residual: float | None
    posterior: str
    relaxed_steps: tuple[int, ...] = ()
    relaxation_db: tuple[float, ...] = ()
    best_margin_db: tuple[float, ...] = ()
    path_cost_m: float | None = None
    best_cost_m: float | None = None
    step_cost_m: float | None = None
    step_excess_m: float | None = None
    reasons: tuple[str, ...] = ()
    min_separation_m: float | None = None
    min_moving_clearance_m: float | None = None
    rule: RuleResult | None = None


MOST_EXCUSED = 10
"""Steps told of one by one."""


def excused_in_words(proofs: Sequence[Certificate]) -> list[str]:
    """Lines for people: which steps miss p_min, by how much, and what excuses each.

    Parameters
    ----------
    proofs
        Of one plan, whose steps are all told of; or one for each step of a run, of which the
        first steps were driven.
    """
    if len(proofs) == 1:
        missed = [(step, proofs[0], k) for k, step in enumerate(proofs[0].relaxed_steps)]
    else:
        missed = [
            (number, proof, proof.relaxed_steps.index(1))
            for number, proof in enumerate(proofs, start=1)
            if 1 in proof.relaxed_steps
        ]
    lines = [
        f"step {step} misses p_min by {proof.relaxation_db[k]:.2f} dB: {_excuse(proof, k)}"
        for step, proof, k in missed[:MOST_EXCUSED]
    ]
    more = len(missed) - MOST_EXCUSED
    return [*lines, f"and {more} more steps"] if more > 0 else lines


def _excuse(proof: Certificate, number: int) -> str:
    """What excuses the miss of this number, as far as the verifier found something."""
    if proof.path_cost_m is not None and proof.best_cost_m is not None:
        return (
            f"the way costs {proof.path_cost_m:.1f} m, the cheapest that the verifier found "
            f"{proof.best_cost_m:.1f} m"
        )
    if number < len(proof.best_margin_db):
        margin_db = proof.best_margin_db[number]
        if margin_db < 0.0:
            return f"the best place found within reach misses it by {-margin_db:.2f} dB"
        return "nothing excuses it"
    return "within constraints.slack_max_db" if not proof.reasons else "nothing excuses it"
