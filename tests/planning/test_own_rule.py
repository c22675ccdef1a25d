"""A rule of connectivity of one's own, against the average written as one, and by hand."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from rules_scene import ruled_problem

from planopt import ConnectivityRule, InputError, check, load, simulate, solve
from planopt.extend import OwnRule
from planopt.planning.plan import History
from planopt.planning.proof.rule import rule_of
from planopt.problems import problem_from_dict, problem_to_dict

SEED = 3


@dataclass(frozen=True)
class Mean(OwnRule):
    """The average share of connected steps, written as a rule of one's own."""

    kind: ClassVar[str] = "mean"

    def achieved(self, probability, history):
        steps = history.steps + probability.shape[-1]
        return (history.connected_steps + probability.sum(axis=-1)) / steps


@dataclass(frozen=True)
class Weakest(OwnRule):
    """The least certain of the first steps: not smooth, and no sum."""

    kind: ClassVar[str] = "weakest"
    steps: float = 2

    def achieved(self, probability, history):
        return probability[..., : int(self.steps)].min(axis=-1)


@dataclass(frozen=True)
class Odd(OwnRule):
    """Returns one number too many."""

    kind: ClassVar[str] = "odd"

    def achieved(self, probability, history):
        return probability


def under(rule: ConnectivityRule, p_min: float):
    """The small tracking problem under a rule of one's own."""
    problem = ruled_problem("average")
    return replace(problem, constraints=replace(problem.constraints, p_min=p_min, rule=rule))


@pytest.mark.parametrize("p_min", [0.5, 0.93])
def test_average_as_an_own_rule_is_the_average(p_min):
    """The same value in the certificate, and a plan that is worth the same."""
    built_in = solve(under(ConnectivityRule("average"), p_min), seed=SEED).plans[0]
    own = solve(under(ConnectivityRule("mean"), p_min), seed=SEED).plans[0]
    assert own.verdict == built_in.verdict == "verified"
    for plan in (built_in, own):
        mean = float(np.mean(plan.connectivity[1:]))
        assert plan.certificate.rule.achieved == pytest.approx(mean, abs=1e-9)
        assert mean >= p_min - 1e-6
    assert own.objective == pytest.approx(built_in.objective, rel=1e-3)


def test_slopes_are_those_of_the_rule():
    """Of two plans, against the closed form of a sum."""
    rule = ConnectivityRule("mean")
    history, chance = History(steps=5, connected_steps=3), np.array([[0.2, 0.9, 1.0], [1, 1, 0.5]])
    value, slope = rule_of(under(rule, 0.8)).slopes(chance, history)
    np.testing.assert_allclose(slope, np.full((2, 3), 1.0 / 8.0), rtol=1e-9)
    np.testing.assert_allclose(value, (3.0 + chance.sum(axis=1)) / 8.0)


def test_a_rule_that_binds_is_kept_in_the_loop_and_by_the_files(tmp_path):
    """Each released plan keeps it by its own probabilities, and `check` agrees from the files."""
    rule = ConnectivityRule("weakest", settings={"steps": 2})
    problem = under(rule, 0.96)
    free = solve(under(rule, 0.01), seed=SEED).plans[0]
    assert free.connectivity[1:3].min() < 0.96, "the rule would not bind"
    settings = replace(problem.planner, max_steps=3)
    run = simulate(replace(problem, planner=settings), seed=SEED)
    for plan in run.plans[0]:
        kept = plan.connectivity[1:3].min() >= 0.96 - 1e-6
        assert kept == (plan.verdict == "verified")
    assert run.plans[0][0].verdict == "verified"
    run.save(tmp_path / "run")
    assessed = check(tmp_path / "run")
    assert (assessed.verdict, assessed.reasons) == ("verified", ())


def test_a_level_at_every_step_is_found():
    """Where the slopes at the best path say little of what keeps the rule."""
    plan = solve(under(ConnectivityRule("weakest", settings={"steps": 8}), 0.92), seed=SEED).plans[
        0
    ]
    assert plan.verdict == "verified"
    assert plan.connectivity[1:].min() >= 0.92 - 1e-6
    assert np.linalg.norm(np.diff(plan.positions_m, axis=0), axis=1).sum() > 1.0


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("unheard", {}, "constraints.connectivity.*unheard.*each_step"),
        ("weakest", {"hops": 2.0}, "constraints.settings.*hops"),
        ("average", {"steps": 2.0}, "constraints.settings"),
    ],
)
def test_unknown_rules_and_settings(name, settings, words):
    """One error of ours that says what there is."""
    with pytest.raises(InputError, match=words):
        ConnectivityRule(name, settings=settings)


@dataclass(frozen=True)
class Checked(OwnRule):
    """Refuses settings, in words of its own."""

    kind: ClassVar[str] = "checked"
    steps: float = 1.0

    def __post_init__(self):
        """Refuse what is below zero, and what is large."""
        if self.steps < 0.0:
            raise InputError("is negative")
        if self.steps > 9.0:
            raise ValueError("is large: mend steps, at most: 9")

    def achieved(self, probability, history):
        return probability.mean(axis=-1)


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (-1.0, r"are not accepted by the rule: is negative \(correct the values"),
        (
            10.0,
            r"\S*Checked\.__post_init__ failed: ValueError: is large: mend steps, "
            r"at most: 9 \(correct the method __post_init__\)$",
        ),
    ],
)
def test_what_a_rule_says_of_settings_is_told_whole(steps, words):
    """Of a problem file, too: nothing is cut at a colon, and there is always a remedy."""
    table = {"connectivity": "checked", "p_min": 0.5, "settings": {"steps": steps}}
    tables = problem_to_dict(load("harbour_track"))
    with pytest.raises(InputError, match=rf"constraints\.settings:? {words}"):
        problem_from_dict({**tables, "constraints": table})


def test_names_of_planopt_stay():
    with pytest.raises(InputError, match="cannot be the name of a rule"):

        @dataclass(frozen=True)
        class Average(OwnRule):
            """A name that is taken."""

            kind: ClassVar[str] = "average"
