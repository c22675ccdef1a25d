"""A run until connected ends when all robots are, and `check` knows when that was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import CONNECT, LEARNING, terms_problem

from planopt.planning.check.check import check
from planopt.planning.files.team_saved import save_team_run
from planopt.planning.loop.run import Outcome
from planopt.planning.plan import Verdict
from planopt.planning.team.team_ending import steps_to_drive, team_ending
from planopt.planning.team.team_loop import simulate_team


def with_threshold(threshold_dbm, **planner):
    """The small problem of finding connection, with a threshold."""
    problem = terms_problem(CONNECT, horizon=3, **planner)
    station = replace(problem.stations[0], threshold_dbm=threshold_dbm)
    return replace(problem, stations=(station,))


def test_all_robots_must_be_connected_at_once() -> None:
    """One after the other is not enough."""
    problem = terms_problem(CONNECT, max_steps=3)
    one_by_one = np.array([[True, False], [False, True], [False, False]])
    assert steps_to_drive(problem, one_by_one) == 3
    assert team_ending(problem, one_by_one)[0] is Outcome.STEP_LIMIT
    together = np.array([[True, False], [True, True]])
    assert steps_to_drive(problem, together) == 2
    assert team_ending(problem, together) == (Outcome.COMPLETED, "connected after step 2")
    other = terms_problem(LEARNING, max_steps=3)
    assert steps_to_drive(other, together) == 3


@pytest.mark.parametrize(
    ("threshold_dbm", "outcome"), [(-45.0, Outcome.COMPLETED), (60.0, Outcome.STEP_LIMIT)]
)
def test_a_run_ends_once_connected(tmp_path, threshold_dbm, outcome) -> None:
    """By the true power, and judged from disk; never where no place connects."""
    problem = with_threshold(threshold_dbm, max_steps=4)
    run = simulate_team(problem, seed=1)
    log = run.runs[0].log
    assert run.runs[0].outcome is outcome
    connected = np.asarray(log.true_dbm)[1:] >= threshold_dbm
    assert len(connected) == (int(np.argmax(connected)) + 1 if connected.any() else 4)
    save_team_run(run, tmp_path)
    verdict = check(tmp_path)
    assert verdict.verdict in (Verdict.VERIFIED, Verdict.VIOLATED)
    assert not [reason for reason in verdict.reasons if "the run ends" in reason]


def test_a_run_that_goes_on_is_rejected(tmp_path, monkeypatch) -> None:
    """Steps driven after all were connected were not asked for."""
    with monkeypatch.context() as longer:
        longer.setattr("planopt.planning.team.team_loop.steps_to_drive", lambda *_: 4)
        run = simulate_team(with_threshold(-45.0, max_steps=4), seed=1)
    save_team_run(run, tmp_path)
    reasons = check(tmp_path).reasons
    assert any("all robots were connected after step 1" in reason for reason in reasons)
