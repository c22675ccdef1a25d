"""Drive a network by the planner that was asked for, and judge its moves."""

from __future__ import annotations

from collections.abc import Callable
from typing import get_args

import numpy as np

from planopt.coverage.simulation import simulate_network
from planopt.errors import InputError
from planopt.problems.settings import MAX_HORIZON, MIN_HORIZON
from planopt.problems.systems import Request
from planopt.systems.coverage.build import CoverageProblem
from planopt.systems.coverage.results import Driven
from planopt.systems.coverage.tables import PlannerName, PlannerTable

REACHED = ("settled", "served")
"""Outcomes of runs that did what the problem asks."""


def planners(content: CoverageProblem, request: Request) -> list[PlannerTable]:
    """Return the planner settings asked for; the laws have one horizon.

    Raises
    ------
    InputError
        A name or a horizon is not allowed.
    """
    own, names = content.given.planner, get_args(PlannerName)
    found: list[PlannerTable] = []
    for name in request.planners or (own.name,):
        if name not in names:
            raise InputError(f"is {name!r}", key="planner.name", remedy=f"use {', '.join(names)}")
        horizons = request.horizons or (own.horizon,)
        for horizon in horizons if name != "law" else (1,):
            if not MIN_HORIZON <= horizon <= MAX_HORIZON:
                raise InputError(
                    f"is {horizon}",
                    key="planner.horizon",
                    remedy=f"use {MIN_HORIZON} to {MAX_HORIZON}",
                )
            found.append(own.model_copy(update={"name": name, "horizon": horizon}))
    return found


def drive(
    content: CoverageProblem,
    planner: PlannerTable,
    seed: int,
    on_step: Callable[[], None] = lambda: None,
) -> Driven:
    """Simulate a network; starts, noise and losses come from the seed."""
    generator = np.random.default_rng(seed)
    scene = content.scene(generator)
    run = simulate_network(scene, content.mover(planner), generator, on_step)
    return Driven(content, run, planner.name, planner.horizon, seed)
