"""The planners of ``examples/planners``: registered by name, verified, and what they know."""

import importlib
import os
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from planopt import Verdict, load, solve
from planopt.extend import PlannerKind, register_planner
from planopt.planning.initial_data import prepare
from planopt.planning.proof.rule import verifier_context
from planopt.planning.scene import build_scene
from planopt.planning.values.context import Aim, step_context, workspace_region
from planopt.world import swept_clearance_m

FOLDER = Path(__file__).parents[1] / "examples" / "planners"
GOALS = {"astar": "AStarPlanner", "colour_rule": "ColourRulePlanner", "rrt_star": "RrtStarPlanner"}


@pytest.fixture(autouse=True)
def examples(monkeypatch: pytest.MonkeyPatch, own_parts: None):
    """The folder of the examples is importable, and nothing stays registered."""
    monkeypatch.syspath_prepend(str(FOLDER))
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if str(FOLDER) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def planner_of(name: str, class_name: str, **traits: bool) -> type:
    kind = getattr(importlib.import_module(name), class_name)
    register_planner(PlannerKind(name.removesuffix("_planner"), kind, **traits))
    return kind


def test_examples_are_short() -> None:
    for file in FOLDER.glob("*.py"):
        assert len(file.read_text().splitlines()) <= 150, file.name


@pytest.mark.parametrize("name", GOALS)
def test_planners_to_a_goal(name: str) -> None:
    """Plans of those that know the radio are released; that of A* is rejected with the reason."""
    planner_of(name, GOALS[name], reaches_goals=True)
    problem = load("open_field")
    plan = solve(problem, planner=name).plan
    assert plan.verdict is Verdict.VERIFIED
    assert ("below constraints.p_min" in plan.rejected) == (name == "astar")


def test_who_sees_coverage() -> None:
    """A* passes the wall on its shorter side, the colour rule on its connected side."""
    problem = load("open_field")
    scene, prepared = build_scene(problem), prepare(problem, 0)
    start = np.array(problem.robots[0].start_m)
    context = verifier_context(problem, scene.index, prepared.belief.posteriors, start)
    step = step_context(context, workspace_region(problem), Aim())
    lows = {}
    for name, class_name in GOALS.items():
        kind = getattr(importlib.import_module(name), class_name)
        route = kind(problem, scene, np.random.default_rng(0)).route(step)
        assert np.allclose(route[[0, -1]], [start, problem.robots[0].goal_m])
        assert (swept_clearance_m(scene.index, route) >= problem.constraints.clearance_m).all()
        lows[name] = route[:, 1].min()
    assert lows["astar"] > 22.0 and lows["colour_rule"] < 16.0


@pytest.mark.skipif(find_spec("do_mpc") is None, reason="do-mpc is not installed (bench extra)")
def test_do_mpc() -> None:
    """Its plan is verified and the objective at most planopt's, which searches globally."""
    planner_of("do_mpc_planner", "DoMpcPlanner")
    problem = load("outdoor_track")
    plans = {name: solve(problem, planner=name, horizon=3).plans for name in ("auto", "do_mpc")}
    own, other = (sum(plan.objective for plan in plans[name]) for name in ("auto", "do_mpc"))
    assert 0.0 < other <= 1.001 * own


@pytest.mark.skipif("SGP_PYTHON" not in os.environ, reason="no environment with SGP-Tools")
def test_sgp_tools() -> None:
    """Its waypoints are driven in order, within the length of N steps, and verified."""
    planner_of("sgp_tools", "SgpToolsPlanner")
    plan = solve(load("outdoor_map"), planner="sgp_tools", horizon=4).plan
    assert plan.verdict is Verdict.VERIFIED
    assert np.linalg.norm(np.diff(plan.positions_m, axis=0), axis=1).sum() > 5.0
