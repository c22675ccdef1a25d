"""Every small falsification of what the verifier makes of several stations is found out.

As in `test_rules_mutants.py`; at least one of the tests of `test_serving.py` must fail.
"""

from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module

import pytest
import test_serving
from mutants import all_hold, replaceable

from planopt.channel.connectivity_law import ConnectivityLaw
from planopt.planning.proof.rule import PathCase, Rule

LAW = "planopt.channel.connectivity_law"
RULE, RULES = "planopt.planning.proof.rule", "planopt.planning.proof.connectivity_rules"
USERS = (LAW, RULE, RULES, "planopt.planning.proof.verify")


# Module, what stands there once, what the mutant has instead.
MUTANTS = (
    (LAW, "_log_normal(score) + none)", "_log_normal(score))"),
    (LAW, "return np.where(log_any < log_none, low, -low)", "return low"),
    (LAW, "thresholds_dbm[0] + spread * score", "thresholds_dbm[0] + score"),
    (LAW, "thresholds_dbm[0] + spread", "thresholds_dbm[-1] + spread"),
    (LAW, "(above + slack_db) / deviation", "above / deviation"),
    (LAW, ".max(axis=0)\n\n\ndef above", ".min(axis=0)\n\n\ndef above"),
    (LAW, "offsets = thresholds_dbm[0] - np", "offsets = 0.0 * np"),
    (LAW, "prediction.mean_db - threshold\n", "prediction.mean_db - thresholds_dbm[0]\n"),
    (
        LAW,
        "self.combined(self.each_power(positions_m, predict))",
        "self.each_power(positions_m, predict)[0]",
    ),
    (RULE, "radio.threshold_dbm for radio in", "problem.stations[0].threshold_dbm for radio in"),
    (RULE, "tuple(posteriors), thresholds", "tuple(posteriors)[::-1], thresholds"),
    (
        RULE,
        "law.probability(self.positions_m[1:], slack_db)",
        "law.probability(self.positions_m[1:], 0)",
    ),
    (LAW, "serving_power_dbm(np.stack(drawn)", "serving_power_dbm(np.stack(drawn[:1])"),
    (RULES, "threshold - slack_db).astype", "threshold + slack_db).astype"),
    (RULES, "drawn_dbm >= threshold", "drawn_dbm < threshold"),
    (RULES, "case, least=1.0)", "case, least=0.0)"),
    (LAW, "[seed, number] if number else seed", "seed"),
)


def facts() -> Iterator[Callable[[], object]]:
    """Every test of `test_serving.py`, ready to be called, the quick ones first."""
    yield test_serving.test_a_path_that_is_handed_over_is_verified
    for by_db in (0.0, 22.0):
        yield partial(test_serving.test_connectivity_is_that_of_independent_stations, by_db)
    yield test_serving.test_probable_data_of_one_step_are_the_probability_of_any
    for station in (0, 1):
        yield partial(test_serving.test_it_is_not_without_either_station, station)
        yield partial(test_serving.test_it_is_violated_with_either_threshold_raised, station)
    for name in test_serving.RULES:
        yield partial(test_serving.test_rules_hold_with_both_stations_and_not_with_one, name)
    yield test_serving.test_the_order_of_stations_does_not_matter
    yield test_serving.test_joint_probability_of_one_step_is_that_of_any
    for name in ("average", "outage", "joint", "data", "probable data", "hard"):
        yield partial(test_serving.test_slack_is_what_all_thresholds_must_be_lowered_by, name)


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: f"{mutant[0][8:]}: {mutant[2]}")
def test_mutant_is_found_out(mutant: tuple[str, str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    users = (*map(import_module, USERS), test_serving)
    for user, name, value, instead in replaceable(mutant, users):
        # Classes stay, but for those that nothing is derived from.
        if not isinstance(value, type) or (
            value is not Rule and issubclass(value, PathCase | Rule | ConnectivityLaw)
        ):
            monkeypatch.setattr(user, name, instead)
    assert not all_hold(facts())
