"""Every small falsification of the rules' source is found out by the tests beside this file.

A mutant replaces the functions of its module wherever the verifier uses them; then at least one of
the tests of `test_rules.py` must fail.
"""

from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module

import pytest
import test_rules
from mutants import all_hold, replaceable

from planopt.planning.proof.rule import Rule

HISTORY, OUTAGE = "planopt.planning.plan", "planopt.channel.joint"
RULE, RULES = "planopt.planning.proof.rule", "planopt.planning.proof.connectivity_rules"
VERIFY, RESULT = "planopt.planning.proof.verify", "planopt.planning.certificate"
USERS = (HISTORY, RULE, RULES, VERIFY, RESULT)


# Module, what stands there once, what the mutant has instead.
MUTANTS = (
    (HISTORY, "count - since,", "since,"),
    (HISTORY, "legs[since:]", "legs[:since]"),
    (HISTORY, "@ connected)", "@ ~connected)"),
    (HISTORY, "(first, first + count + 1)", "(0, count + 1)"),
    (HISTORY, "np.minimum(step_s", "np.maximum(step_s"),
    (RULES, "history.steps + 1 + np", "1 + np"),
    (RULES, "history.steps + 1 + np", "history.steps + np"),
    (RULES, "probability, 1.0).min", "probability, 1.0).max"),
    (HISTORY, "(data_mbit or 0.0) - history.delivered_mbit", "(data_mbit or 0.0)"),
    (HISTORY, "missing * most /", "missing * rate_mbit_s * left_s /"),
    (HISTORY, "or left_s <= 0.0 or", "or left_s > 0.0 or"),
    (HISTORY, "- history.steps * problem.planner.step_s", ""),
    (RULES, "(1.0 - p_min) * (most", "p_min * (most"),
    (RULES, "return probability @", "return np.ones_like(probability) @"),
    (RULES, "case.history) >= least", "case.history) <= least"),
    (RULES, "if least > 0.0 else 1.0", "if least < 0.0 else 1.0"),
    (RULES, "sample(case.positions_m[1:]", "sample(case.positions_m[:-1]"),
    (RULES, "history.connected_steps + p", "p"),
    (RULES, "history.steps + p", "p"),
    (RULES, "probability.sum(axis=-1)", "probability.max(axis=-1)"),
    (OUTAGE, "run + sizes", "sizes"),
    (OUTAGE, "missed[..., step], run", "~missed[..., step], run"),
    (OUTAGE, "np.full(missed.shape[:-1], begun)", "np.zeros(missed.shape[:-1])"),
    (OUTAGE, "np.maximum(longest, run)", "run"),
    (RULES, "below, self._begun(history)", "below, 0.0"),
    (RULES, "probability < self.p_min", "probability > self.p_min"),
    (RULES, "return -self.limit", "return -2.0 * self.limit"),
    (RULES, "1.0 - (1.0 - probability).sum(axis=-1)", "probability.prod(axis=-1)"),
    (RULES, "threshold - slack_db, p_min", "threshold + slack_db, p_min"),
    (RULES, "exact.value - found.exact.error", "exact.value + found.exact.error"),
    (RULES, "max(proven, key", "min(proven, key"),
    (RULES, "case.problem, case.positions_m[1:]", "case.problem, case.positions_m[:-1]"),
    (RULES, "of - count + 1", "count + 1"),
    (RULE, "threshold_dbm - slack_db\n", "threshold_dbm\n"),
    (RULE, "slack_db=high)", "slack_db=0.5 * high)"),
    (RULE, "or result.slack_db > 0.0", "or result.slack_db >= 0.0"),
    (RULE, "if limit == 0.0 or", "if limit >= 0.0 or"),
    (RULE, "sign = -1.0 if", "sign = 1.0 if"),
    (RESULT, "self.missing > RULE", "self.missing < RULE"),
    (VERIFY, "missing > limit + MARGIN_TOLERANCE_DB", "missing > 1e3 + limit"),
    (VERIFY, "missing > limit + MARGIN_TOLERANCE_DB", "missing < limit"),
    (VERIFY, "(margins < -MARGIN_TOLERANCE_DB) & counted", "margins < -MARGIN_TOLERANCE_DB"),
    (VERIFY, "if constraints.rule.slack_max_db is not None:", "if False:"),
    (VERIFY, "max(relaxation_db, default=0.0)", "min(relaxation_db, default=0.0)"),
)


def facts() -> Iterator[Callable[[], object]]:
    """The tests of `test_rules.py`, each ready to be called."""
    for name, test in vars(test_rules).items():
        if name.startswith("test_"):
            [mark] = getattr(test, "pytestmark", [None])
            yield from (partial(test, value) for value in mark.args[1]) if mark else [test]


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: f"{mutant[0][17:]}: {mutant[2]}")
def test_mutant_is_found_out(mutant, monkeypatch):
    users = (*map(import_module, USERS), test_rules)
    for user, name, value, instead in replaceable(mutant, users):
        if value is Rule or name == "RuleResult":
            # Other classes are derived from it, or compared with it.
            for member, own in vars(instead).items():
                if not member.startswith("__"):
                    monkeypatch.setattr(value, member, own)
        # Classes stay, but for rules: they are compared with each other.
        elif not isinstance(value, type) or issubclass(value, Rule) or name == "PathCase":
            monkeypatch.setattr(user, name, instead)
    assert not all_hold(facts())
