"""The worst of several certificates in each respect."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from planopt.planning.certificate import Certificate, dearest
from planopt.planning.rule_result import worst_result


def worst_of_robots(certificates: Mapping[str, Certificate]) -> Certificate:
    """The worst of robots' certificates, step by step; reasons say whose they are.

    Parameters
    ----------
    certificates
        By the robot's name.
    """
    all_of_them = tuple(certificates.values())
    if len(all_of_them) == 1:
        return all_of_them[0]
    missed = [c for c in all_of_them if c.relaxed_steps]
    relaxation: dict[int, float] = {}
    best: dict[int, float] = {}
    for c in missed:
        for step, missing_db in zip(c.relaxed_steps, c.relaxation_db, strict=True):
            relaxation[step] = max(missing_db, relaxation.get(step, 0.0))
        for step, margin_db in zip(c.relaxed_steps, c.best_margin_db, strict=False):
            best[step] = min(margin_db, best.get(step, margin_db))
    residuals = [c.kkt_residual for c in all_of_them if c.kkt_residual is not None]
    return Certificate(
        min_clearance_m=min(c.min_clearance_m for c in all_of_them),
        min_connectivity=min(c.min_connectivity for c in all_of_them),
        dynamics_defect=max(c.dynamics_defect for c in all_of_them),
        kkt_residual=max(residuals, default=None),
        posterior=next((c.posterior for c in all_of_them if c.posterior != "exact"), "exact"),
        relaxed_steps=tuple(sorted(relaxation)),
        relaxation_db=tuple(relaxation[step] for step in sorted(relaxation)),
        best_margin_db=tuple(best[step] for step in sorted(best)),
        **dearest(all_of_them),
        reasons=tuple(
            f"{robot}: {reason}" for robot, c in certificates.items() for reason in c.reasons
        ),
        min_separation_m=least_of(c.min_separation_m for c in all_of_them),
        min_moving_clearance_m=least_of(c.min_moving_clearance_m for c in all_of_them),
        rule=worst_result(c.rule for c in all_of_them),
    )


def least_of(values: Iterable[float | None]) -> float | None:
    """The least of the numbers that there are; None if there is none."""
    return min((value for value in values if value is not None), default=None)
