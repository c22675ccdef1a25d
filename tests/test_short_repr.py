"""Short texts of data with arrays: five lines at most, whatever is in them."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from refusals import refused

import planopt
from planopt import Run, Solution
from planopt.short_repr import short_repr, shown_number


@dataclass(frozen=True)
class Holder:
    """Anything."""

    value: Any
    _hidden: int = 0

    __repr__ = short_repr


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (np.array([1.25, np.nan]), "[1.25, nan]"),
        (np.zeros(0), "<(0,)>"),
        (np.full((2, 9), np.nan), "<(2, 9), none finite>"),
        (np.array([[1.0, np.inf], [-2.0, 3.0]]), "<(2, 2), -2 to 3>"),
        (np.arange(9) > 6, "<(9,), 2 true>"),
        (np.array(["a"] * 9), "<(9,)>"),
        (1.0 / 3.0, "0.333333"),
        ((1, "a"), "(1, 'a')"),
        ([], "()"),
        (list(range(9)), "<9 x int>"),
        ({"a": 0.25}, "{'a': 0.25}"),
        (planopt.Verdict.VERIFIED, "'verified'"),
        (None, "None"),
        (Holder(1), "Holder(value=1)"),
        (Holder("long" * 99), "Holder(...)"),
    ],
)
def test_values(value: object, shown: str) -> None:
    """Arrays by shape and range, long lists by number, data within data if it is short."""
    assert repr(Holder(value)) == f"Holder(value={shown})"


def test_at_most_five_lines() -> None:
    """What does not fit is left out with a sign."""
    lines = repr(Holder({key: "word " * 9 for key in range(99)})).splitlines()
    assert len(lines) == 5 and lines[-1].endswith(" ...")
    assert max(map(len, lines)) <= 100


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Of everything that people print, with the words that must be in it."""
    field, track = planopt.load("open_field"), planopt.load("outdoor_track")
    short = replace(track, planner=replace(track.planner, max_steps=2))
    solution = planopt.solve(field, horizon=10)
    belief = solution.belief
    folder = tmp_path_factory.mktemp("results") / "plan"
    solution.save(folder)
    return {
        "CheckResult(verdict='verified'": planopt.check(folder),
        "steps driven: 0": planopt.Planner(field, horizon=2),
        "open_field": field,
        "verified": solution,
        "south": planopt.solve(track, horizon=2),
        "reached": planopt.simulate(field, horizon=1),
        "after 2 steps": planopt.simulate(short, horizon=1),
        "reml": belief.fit,
        "Belief": belief,
        "ChannelPosterior": belief.posterior,
        "120": belief.posterior.measurements,
        "(11, 2)": solution.plan,
    }


def test_everything_people_print_is_short(results: dict[str, Any]) -> None:
    """Five lines of at most 110 letters, with what matters in them."""
    for word, result in results.items():
        lines = repr(result).splitlines()
        assert len(lines) <= 5 and max(map(len, lines)) <= 110, repr(result)
        assert word in repr(result), repr(result)


def test_one_robot_and_several_answer_to_the_same_names(results: dict[str, Any]) -> None:
    """`plan` and `plans`, `run` and `runs`; with several robots the first says what to use."""
    one, team = results["verified"], results["south"]
    assert isinstance(one, Solution) and isinstance(team, Solution)
    assert one.plans == (one.plan,)
    with refused():
        _ = team.plan
    alone = replace(team, plans=team.plans[:1])
    assert alone.plan is team.plans[0]
    run, teams = results["reached"], results["after 2 steps"]
    assert isinstance(run, Run) and isinstance(teams, Run)
    assert run.runs == (run.run,)
    assert run.verified_rate == run.run.verified_rate
    with refused():
        _ = teams.run
    assert replace(teams, runs=teams.runs[:1]).run is teams.runs[0]


def test_a_rounding_error_is_shown_as_zero() -> None:
    """The effort of a plan that stands still is some 1e-24 s; a small probability is kept."""
    shown = [shown_number(value, " s") for value in (2.9e-24, -1e-17, 4e-9, float("nan"))]
    assert shown == ["0 s", "0 s", "4e-09 s", "nan s"]
