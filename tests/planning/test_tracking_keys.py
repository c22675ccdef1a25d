"""Keys of the term tracking: weights of steps, and what counts of the covariance."""

from dataclasses import replace

import numpy as np
import pytest
from terms_scene import ENERGY, TRACKING, context_of, scorer_of, terms_problem

from planopt import InputError, Verdict, check, solve
from planopt.objectives import TrackingTerm
from planopt.objectives.terms.term import TermSetting
from planopt.objectives.terms.tracking import LONGEST_ADDITIVE
from planopt.planning.planners import planner_for
from planopt.problems import problem_to_dict
from planopt.problems.load import with_overrides


def term_context(**keys):
    """A tracking term of these keys, and the situation of the small problem."""
    problem = terms_problem({**TRACKING, **keys}, horizon=4)
    return problem.terms[0], context_of(problem)[0]


@pytest.mark.parametrize("form", ["additive", "recourse"])
def test_step_weights_multiply_steps(form):
    """Only the first step counts: the value of a path is that of its first step alone."""
    term, at = term_context(form=form, step_weights=[2.0, 0.0])
    plain, alone = term_context(form=form, step_weights=[1.0, 0.0])
    path = at.position_m + np.arange(1, 5)[:, None] * np.array([0.8, 0.3])
    assert term.value(at, path) == pytest.approx(2.0 * plain.value(alone, path), rel=1e-9)
    bent = path.copy()
    bent[1:] += 1.0
    assert plain.value(alone, bent) == pytest.approx(plain.value(alone, path), rel=0.05)
    np.testing.assert_array_equal(term.weights_of(4), [2.0, 0.0, 0.0, 0.0])


def test_a_terminal_weight_is_the_last_steps():
    """The last step of a plan counts so many times; of a single step that is all."""
    term, at = term_context(terminal_weight=3.0)
    plain, _ = term_context()
    path = at.position_m + np.arange(1, 5)[:, None] * np.array([0.8, 0.3])
    last, _ = term_context(step_weights=[0.0, 0.0, 0.0, 1.0])
    value = plain.value(at, path) + 2.0 * last.value(at, path)
    _, fresh = term_context()
    assert term.value(fresh, path) == pytest.approx(value, rel=1e-12)
    np.testing.assert_array_equal(term.weights_of(1), [3.0])


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (
            {"criterion": "determinant", "form": "additive"},
            "which form = .additive. does not support",
        ),
        ({"step_weights": [0.0]}, "no step counts"),
        ({"step_weights": [-1.0]}, "step_weights"),
        ({"terminal_weight": 0.0}, "terminal_weight"),
        ({"criterion": "size", "form": "recourse"}, "criterion"),
    ],
)
def test_keys_that_do_not_fit_are_refused(keys, words):
    with pytest.raises(InputError, match=words):
        terms_problem({**TRACKING, **keys})


def test_the_form_follows_the_horizon(tmp_path):
    """Plans are those of the form that auto is; the problem keeps the word that it was given."""
    forms = {form: {**TRACKING, "form": form} for form in ("auto", "additive", "recourse")}

    def solved(name, horizon):
        return solve(terms_problem(forms[name], horizon=horizon, name="lattice"), seed=0)

    for horizon, form in ((1, "additive"), (2, "recourse")):
        found, stated = solved("auto", horizon), solved(form, horizon)
        assert found.plans[0].objective == stated.plans[0].objective
        np.testing.assert_array_equal(found.plans[0].positions_m, stated.plans[0].positions_m)
    assert problem_to_dict(found.problem)["objective"]["terms"][0]["form"] == "auto"
    found.save(tmp_path / "plan")
    assert check(tmp_path / "plan").reasons == ()
    short = with_overrides(found.problem, horizon=1)
    assert found.problem.terms[0].form == "recourse" and short.terms[0].form == "additive"


@pytest.mark.parametrize(("horizon", "form"), [(1, "additive"), (2, "recourse")])
def test_the_form_of_packets_that_have_estimates(horizon, form):
    """From two steps on, beside another term: a later packet tells of the first step too."""
    terms = {**TRACKING, "form": "auto"}, ENERGY
    problem = terms_problem(*terms, horizon=horizon, name="lattice")
    target = replace(problem.targets[0], packets="estimates")
    assert replace(problem, targets=(target,)).terms[0].form == form


def test_the_form_beside_bounds_dynamics_and_other_criteria():
    """Additive up to ten steps beside a bound and with dynamics; recourse for other criteria."""
    term = TrackingTerm(0.008, 0.08, 1.0)
    driven = TermSetting(40, 1, True, has_dynamics=True, is_free=True)
    bound = TermSetting(40, 1, True)
    for setting in (driven, bound):
        assert term.planned(setting).form == "recourse"
        assert term.planned(replace(setting, horizon=LONGEST_ADDITIVE)).form == "additive"
    assert term.planned(replace(bound, is_free=True, horizon=2)).form == "recourse"
    squares = replace(term, criterion="determinant")
    assert squares.planned(replace(bound, horizon=1)).form == "recourse"
    stated = replace(term, form="additive")
    assert stated.planned(bound) is stated


def planned_with(**keys):
    """The plan of tries for these keys of the term and the planner."""
    criterion = keys.pop("criterion", "trace")
    problem = terms_problem({**TRACKING, "form": "recourse", "criterion": criterion}, **keys)
    context, belief = context_of(problem)
    scorer, ground = scorer_of(context, belief)
    planner = planner_for(problem, ground, np.random.default_rng(0))
    return planner.plan(context, scorer)


@pytest.mark.parametrize("p_min", [0.0, 0.5, 0.9])
def test_tries_keep_a_chance_constraint(p_min):
    """The best path that keeps it is released, and a tighter bound never improves the value."""
    plan = planned_with(horizon=4, p_min=p_min)
    assert plan.verdict is Verdict.VERIFIED
    assert plan.objective <= planned_with(horizon=4).objective + 1e-12


@pytest.mark.parametrize("criterion", ["determinant", "norm"])
def test_plans_of_every_criterion_are_verified(criterion):
    """The norm is half the trace, and has its plan."""
    plain, found = (planned_with(horizon=3, criterion=name) for name in ("trace", criterion))
    assert found.verdict is Verdict.VERIFIED
    if criterion == "norm":
        assert found.objective == pytest.approx(0.5 * plain.objective, rel=1e-9)
