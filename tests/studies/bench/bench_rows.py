"""Rows of the regression suite with chosen numbers."""

from dataclasses import replace
from typing import Any

from planopt.studies.bench_cases import Row

ROW = Row(
    problem="yard",
    kind="plan",
    cost_to_go="connected",
    horizon=10,
    seed=0,
    planner="auto",
    sense="min",
    objective=100.0,
    verdict="verified",
    termination="converged",
    rungs={"plan": 1},
    outcome="planned",
    accepted=True,
    reasons=(),
    iterations=12,
    solve_s=0.02,
    wall_s=0.1,
    cpu_s=0.1,
    steps=1,
    path_digest="0123456789abcdef",
    kkt_residual=1e-6,
    min_clearance_m=2.0,
    min_connectivity=0.9,
)


def row(**changes: Any) -> Row:
    return replace(ROW, **changes)
