"""Standing in the way of what moves, and margins too small to rely on before they are proven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import TRACKING, situation_of, terms_problem

from planopt.planning.plan import Rung, Termination, Verdict
from planopt.planning.programme.path_polish import RefinedPath
from planopt.planning.proof import context as predictions
from planopt.planning.proof.context import SEARCH_ERROR_DB
from planopt.planning.rule_bounds import lacks
from planopt.planning.solve import solve
from planopt.planning.values.rule_rows import rule_rows
from planopt.world.workspace import MovingObstacle


def test_standing_before_the_first_plan_is_a_stop() -> None:
    """Nothing is reserved but standing, so that there is no last plan to go on with."""
    problem = terms_problem(TRACKING, horizon=3)
    x, y = problem.robots[0].start_m
    # Wider and faster than the robot can flee from.
    steamroller = MovingObstacle("roller", 60.0, (0.0,), ((x + 90.0, y),), (-40.0, 0.0))
    blocked = replace(problem, workspace=replace(problem.workspace, moving=(steamroller,)))
    plan = solve(blocked).plans[0]
    assert plan.verdict is Verdict.VIOLATED
    assert plan.rung is Rung.STOP
    assert np.ptp(plan.positions_m, axis=0).max() == 0.0


@pytest.mark.parametrize("exact", [True, False])
def test_a_margin_within_the_error_of_searches_is_not_relied_on(exact, monkeypatch) -> None:
    """Half of the error to spare is enough where searches are exact, or once it was tried."""
    problem = terms_problem(TRACKING, horizon=4, p_min=0.6)
    situation, _ = situation_of(problem)
    path = np.tile(situation.position_m, (4, 1)) + np.arange(1.0, 5.0)[:, None] * (0.5, 0.2)
    rows = rule_rows(situation, path)
    # The threshold is set so that the path has just that to spare.
    least = float(rows.margins_db(situation.power(path)).min())
    rows = replace(rows, threshold_dbm=rows.threshold_dbm + least - 0.5 * SEARCH_ERROR_DB)
    if not exact:
        monkeypatch.setattr(predictions, "SEARCH_EXACT_LIMIT", 0)
    point = RefinedPath(path, np.zeros(4), Termination.CONVERGED, 5, 0.0, {})
    assert lacks(situation, rows, point, firmly=True) is not exact
    assert not lacks(situation, rows, point)
