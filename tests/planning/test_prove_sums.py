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
