"""Runs for sums of terms with two stations: verified, saved, judged again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from terms_scene import CONNECT, LEARNING, TRACKING, own_term, terms_problem

from planopt import check
from planopt.channel.connectivity_law import serving_power_dbm
from planopt.channel.ground_truth import true_power_dbm
from planopt.planning.files.belief_file import BELIEF_FILE
from planopt.planning.loop.closed_loop import simulate


def connected(path: Any) -> Any:
    """An expression of one's own: connected as often as may be."""
    import casadi as ca

    return ca.sum1(path.connectivity)


CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "track": (TRACKING, {"p_min": 0.8}),
    "recourse": ({**TRACKING, "form": "recourse"}, {}),
    "connect": (CONNECT, {}),
    "learn": (LEARNING, {}),
    "map": ({"kind": "mapping", "form": "information"}, {}),
    "own": (own_term(connected, 3), {"p_min": 0.8}),
    "one step": (TRACKING, {"name": "one_step"}),
}


@pytest.mark.parametrize("case", CASES)
def test_a_run_is_verified_and_judged_again(case: str, tmp_path: Path) -> None:
    """What was driven was connected to whichever station was the better one."""
    term, planner = CASES[case]
    problem = terms_problem(term, stations=2, horizon=3, max_steps=2, **planner)
    run = simulate(problem, seed=1)
    assert run.verified_rate == 1.0
    log = run.runs[0].log
    powers = [true_power_dbm(t, log.positions_m) for t in run.truths]
    thresholds = [radio.threshold_dbm for radio in problem.stations]
    assert np.array_equal(log.true_dbm, serving_power_dbm(np.stack(powers), thresholds))
    any_of_them = (np.stack(powers) >= np.array(thresholds)[:, None]).any(axis=0)
    assert np.array_equal(log.connected, any_of_them)
    run.save(tmp_path)
    assert check(tmp_path).reasons == ()
    with np.load(tmp_path / BELIEF_FILE) as archive:
        arrays = {name: archive[name] for name in archive}
    arrays["stations[1].power_dbm"][-1] += 0.5
    np.savez_compressed(tmp_path / BELIEF_FILE, **arrays)
    assert any("stations[1].power_dbm" in reason for reason in check(tmp_path).reasons)
