"""Proven bounds of sums over steps: their certificate, and terms that have none."""

import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

import planopt
from planopt import Solution
from planopt.objectives import TrackingTerm
from planopt.problems import GivenParameters


@pytest.fixture(scope="module")
def solution() -> Solution:
    """Three robots that track a target among obstacles."""
    return planopt.solve(planopt.load("outdoor_track"), horizon=5, prove_s=6.0)


def test_additive_tracking_is_nearly_optimal(solution: Solution) -> None:
    """The bound of each robot is at least its value, and within half a percent."""
    for plan in solution.plans:
        bound = plan.bound
        assert bound is not None and bound.value is not None
        assert plan.objective == bound.cost <= bound.value
        assert bound.gap == pytest.approx(bound.value / bound.cost - 1.0)
        assert bound.gap <= 0.005
        assert "branch and bound" in str(bound.method)


def test_the_bound_is_proven_again(solution: Solution, tmp_path: Path) -> None:
    """``check`` accepts the certificate, and rejects a bound that it does not prove."""
    solution.save(tmp_path / "right")
    assert planopt.check(tmp_path / "right").verdict is planopt.Verdict.VERIFIED
    for number, value in ((0, 0.9999), (1, 1.0001)):
        plans = list(solution.plans)
        bound = plans[number].bound
        certificate = replace(bound.certificate, value=value * bound.cost)
        plans[number] = replace(
            plans[number], bound=replace(bound, value=value * bound.cost, certificate=certificate)
        )
        replace(solution, plans=tuple(plans)).save(tmp_path / f"{number}")
    assert planopt.check(tmp_path / "0").verdict is planopt.Verdict.VIOLATED
    data = json.loads((tmp_path / "right" / "plan.json").read_text())
    data["robots"][0]["bound"] *= 1.01
    (tmp_path / "right" / "plan.json").write_text(json.dumps(data))
    assert planopt.check(tmp_path / "right").verdict is planopt.Verdict.VIOLATED


def test_plans_through_known_connections_are_proven_again(tmp_path: Path) -> None:
    """Readings beyond the predicted coverage improve the plan, and ``check`` accepts its bound."""
    known = GivenParameters(
        shadow_std_db=0.5, decorrelation_m=2.0, multipath_std_db=3.0, k_pl_db=-10.0, n_pl=2.0
    )
    problem = planopt.Problem(
        robots=planopt.Robot(start_m=(28.0, 20.0), speed_max_m_s=2.0),
        stations=planopt.BaseStation(
            position_m=(5.0, 20.0), transmit_power_dbm=0.0, threshold_dbm=-40.0
        ),
        workspace=planopt.Workspace((0.0, 0.0, 70.0, 40.0)),
        targets=planopt.Target(start_m=(60.0, 20.0), velocity_m_s=(0.0, 0.0)),
        objective=TrackingTerm(
            form="additive", noise_curvature=0.02, noise_floor_m2=0.1, sweet_spot_m=1.0
        ),
        channel=planopt.ChannelSetup(given=known),
        constraints=planopt.Constraints(p_min=0.8),
        planner=planopt.PlannerSettings(step_s=1.0, horizon=4),
    )
    places = np.array([[28.0, 18.5], [29.5, 21.0], [30.5, 19.5], [31.7, 20.8], [33.0, 20.0]])
    read = planopt.Measurements(places, np.full(5, -38.5))
    solution = planopt.solve(problem, measurements=read, prove_s=20.0)
    np.testing.assert_allclose(solution.plan.positions_m[1:], places[1:], atol=1e-5)
    bound = solution.plan.bound
    assert bound is not None and bound.gap is not None and 0.0 < bound.gap < 0.001
    solution.save(tmp_path / "plan")
    assert planopt.check(tmp_path / "plan").verdict is planopt.Verdict.VERIFIED


@dataclass(frozen=True)
class Doubled(TrackingTerm):
    """A tracking term with another value than its bounds are for."""

    kind: ClassVar[str] = "doubled_for_bounds"

    def value(self, at: object, path_m: np.ndarray) -> float:
        return 2.0 * super().value(at, path_m)


def test_terms_without_a_bound_say_so() -> None:
    """Recourse, and a term that only inherits its bounds, have no bound but a reason."""
    problem = planopt.load("outdoor_track")
    [term] = problem.terms
    for other, words in (
        (replace(term, form="recourse"), "recourse"),
        (Doubled(**{each.name: getattr(term, each.name) for each in fields(term)}), "doubled"),
    ):
        objective = planopt.objectives.TermsObjective((other,))
        changed = replace(problem, robots=problem.robots[:1], objective=objective)
        plan = planopt.solve(changed, horizon=2, prove_s=0.5).plan
        assert plan.bound is not None and plan.bound.value is None
        assert plan.bound.gap is None and words in plan.bound.reason


@pytest.mark.parametrize(
    ("name", "changes"),
    [("fig2", {"criterion": "T"}), ("fig3", {"form": "path", "closeness_per_m": 0.1})],
)
def test_single_measurements_are_proven_best(name: str, changes: dict[str, object]) -> None:
    """Learning and mapping one step ahead have tight bounds; two steps of learning a loose one."""
    problem = planopt.load(name)
    objective = planopt.objectives.TermsObjective((replace(problem.terms[0], **changes),))
    problem = replace(problem, objective=objective)
    bound = planopt.solve(problem, horizon=1, prove_s=3.0).plan.bound
    assert bound is not None and bound.value is not None
    assert bound.cost <= bound.value <= 1.001 * bound.cost
    if name == "fig2":
        longer = planopt.solve(problem, horizon=2, prove_s=1.0).plan.bound
        assert longer is not None and longer.value is not None and longer.cost <= longer.value
