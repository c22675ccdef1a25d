"""Every small falsification of the rules' source is found out by the tests beside this file.

A mutant replaces the functions of its module wherever the verifier uses them; then at least one of
the tests of `test_rules.py` must fail.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import test_rules

from planopt.planning.proof.rules.proven import PathCase, ProvenRule

HISTORY = "planopt.planning.history"
ROOM = "planopt.planning.proof.rules"
PROVEN = f"{ROOM}.proven"
ASKED, OUTAGE = f"{ROOM}.asked", f"{ROOM}.outage"
WHOLE = f"{ROOM}.whole_plan"
DATA, DRAWS = f"{ROOM}.probable_data", f"{ROOM}.path_draws"
STEPS = f"{ROOM}.single_steps"
USERS = (
    HISTORY,
    ASKED,
    PROVEN,
    OUTAGE,
    DATA,
    DRAWS,
    WHOLE,
    STEPS,
    "planopt.planning.proof.verify",
)

# Module, what stands there once, what the mutant has instead.
MUTANTS = (
    (HISTORY, "count - since,", "since,"),
    (HISTORY, "legs[since:]", "legs[:since]"),
    (HISTORY, "@ connected)", "@ ~connected)"),
    (HISTORY, "(first, first + count + 1)", "(0, count + 1)"),
    (HISTORY, "np.minimum(step_s", "np.maximum(step_s"),
    (PROVEN, "history.steps + 1 + np", "1 + np"),
    (PROVEN, "history.steps + 1 + np", "history.steps + np"),
    (ASKED, "rule.data_mbit - history.delivered_mbit", "rule.data_mbit"),
    (ASKED, "missing * share", "missing"),
    (ASKED, "if left_s <= 0.0 or", "if left_s > 0.0 or"),
    (ASKED, "rule.deadline_s - history.steps * problem.planner.step_s", "rule.deadline_s"),
    (PROVEN, "history.connected_steps + float", "float"),
    (PROVEN, "history.steps + len", "len"),
    (PROVEN, "probability.sum()", "probability.max()"),
    (PROVEN, "each @ probability", "each.sum()"),
    (OUTAGE, "current + size if out", "size if out"),
    (OUTAGE, "if out else 0.0", "if not out else 0.0"),
    (OUTAGE, "= 0.0, before", "= 0.0, 0.0"),
    (OUTAGE, "max(longest, current)", "current"),
    (OUTAGE, "missed, history.outage_m)", "missed, 0.0)"),
    (DRAWS, "threshold_dbm - slack_db\n", "threshold_dbm + slack_db\n"),
    (DRAWS, "exact.value - found.exact.error", "exact.value + found.exact.error"),
    (DRAWS, "max(proven, key", "min(proven, key"),
    (DATA, "connected @ each >=", "connected @ each <="),
    (DATA, "asked_mbit > 0.0", "asked_mbit >= 0.0"),
    (DATA, "of - count + 1", "count + 1"),
    (PROVEN, "threshold_dbm - slack_db\n", "threshold_dbm\n"),
    (PROVEN, "margin_db + slack_db", "margin_db"),
    (WHOLE, "slack_db=high)", "slack_db=0.5 * high)"),
    (WHOLE, "or result.slack_db > 0.0", "or result.slack_db >= 0.0"),
    (WHOLE, "if limit == 0.0 or", "if limit >= 0.0 or"),
    (
        PROVEN,
        "joint_by_slack(case.problem, case.posterior, case.positions_m[1:], case.broad)",
        "joint_by_slack(case.problem, case.posterior, case.positions_m[:-1], case.broad)",
    ),
    (
        PROVEN,
        "path_draws_dbm(case.posterior, case.positions_m[1:], case.broad)",
        "path_draws_dbm(case.posterior, case.positions_m[:-1], case.broad)",
    ),
    (ASKED, "result.missing > RULE", "result.missing < RULE"),
    (ASKED, "margin_db < -MARGIN", "margin_db > MARGIN"),
    (STEPS, "missing > limit + MARGIN_TOLERANCE_DB", "missing > 1e3 + limit"),
    (STEPS, "missing > limit + MARGIN_TOLERANCE_DB", "missing < limit"),
    (STEPS, "(margins < -MARGIN_TOLERANCE_DB) & asked", "margins < -MARGIN_TOLERANCE_DB"),
    (STEPS, "if constraints.rule.slack_max_db is not None:", "if False:"),
    (STEPS, "max(relaxation_db, default=0.0)", "min(relaxation_db, default=0.0)"),
)


def facts() -> Iterator[Callable[[], object]]:
    """The tests of `test_rules.py`, each ready to be called."""
    parametrised = "test_slack_is_the_least_lowering_of_the_threshold"
    for name, test in vars(test_rules).items():
        if name.startswith("test_") and name != parametrised:
            yield test
    for form in ("average", "data", "outage", "joint"):
        yield partial(getattr(test_rules, parametrised), form)


def source_of(module: str) -> str:
    """Its text."""
    spec = find_spec(module)
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).read_text()


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: f"{mutant[0][17:]}: {mutant[2]}")
def test_mutant_is_found_out(mutant, monkeypatch):
    """Some test fails with it."""
    module, original, instead = mutant
    source = source_of(module)
    assert source.count(original) == 1, "the mutant does not fit the source any more"
    changed = ModuleType("mutant_of_a_rule")
    # Data classes look their module up.
    monkeypatch.setitem(sys.modules, changed.__name__, changed)
    exec(compile(source.replace(original, instead), "<mutant>", "exec"), changed.__dict__)
    for user in (*(import_module(name) for name in USERS), test_rules):
        for name, value in list(vars(user).items()):
            if callable(value) and getattr(value, "__module__", None) == module:
                # Classes stay, but for rules: they are compared with each other.
                if not isinstance(value, type) or issubclass(value, ProvenRule | PathCase):
                    monkeypatch.setattr(user, name, getattr(changed, name))

    def holds(fact: Callable[[], object]) -> bool:
        try:
            with np.errstate(all="ignore"):
                fact()
        except Exception:
            return False
        return True

    assert not all(holds(fact) for fact in facts())
