"""Association of unnamed reports, and pursuits with misses and false alarms."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from test_updates import changed

import planopt
from planopt.pursuit import AssociatedRecords, Record, Report, SnapshotService, verify_pursuit
from planopt.tasks.pursuit import verifier_data

SERVICE = SnapshotService(5, 10.0, 0.1, 4)
MISS, ALARMS, SPEED_M_S = 0.2, 1.5, 4.0


def drawn(seed):
    """Starts of two evaders, and six reports of them and of nothing."""
    generator = np.random.default_rng(seed)
    starts = [Record(0.0, generator.uniform(130.0, 190.0, 2), 5.0) for _ in range(2)]
    period_s = float(SERVICE.periods_s[0])
    samples = np.sort(generator.integers(1, 30, 6)).tolist()
    reports = []
    for sample in samples:
        level = int(generator.integers(0, 2)) if sample % 2 == 0 else 0
        near = starts[int(generator.integers(2))].reported_m + generator.normal(0.0, 12.0, 2)
        error_m = SERVICE.error_bound_m(level)
        reports.append(Report(sample, level, Record(sample * period_s, near, error_m)))
    return starts, reports


def worth(before, after):
    """Logarithm of the likelihood of a link over that of a false alarm; None out of reach."""
    lapse_s = after.record.sampled_s - max(0.0, before.record.sampled_s)
    apart_m = after.record.reported_m - before.record.reported_m
    errors_m = before.record.error_m, after.record.error_m
    reach_m = SPEED_M_S * lapse_s + sum(errors_m)
    if after.sample <= before.sample or np.hypot(*apart_m) > reach_m:
        return None
    step = 2 ** max(before.level, after.level)
    missed = (after.sample - max(before.sample, 0) - 1) // step
    std_m = math.sqrt(0.5 * (SPEED_M_S * lapse_s) ** 2 + sum(e**2 for e in errors_m) / 6.0)
    fits = norm.logpdf(apart_m, scale=std_m).sum()
    return fits + math.log((1 - MISS) * SERVICE.side_m**2 / ALARMS) + missed * math.log(MISS)


def test_chains_are_the_best_of_all_assignments():
    for seed in range(8):
        starts, reports = drawn(seed)
        generator = np.random.default_rng(0)
        source = AssociatedRecords(SERVICE, (MISS, ALARMS), starts, SPEED_M_S, generator)
        first = [Report(-(1 << 62), 0, each) for each in starts]
        values = {}
        for owners in itertools.product((-1, 0, 1), repeat=len(reports)):
            total = 0.0
            for evader, start in enumerate(first):
                chain = [start, *(r for r, o in zip(reports, owners, strict=True) if o == evader)]
                links = [worth(a, b) for a, b in itertools.pairwise(chain)]
                total += -math.inf if None in links else sum(links)
            values[owners] = total
        found = tuple(source.associated(first, reports))
        assert values[found] == pytest.approx(max(values.values()), abs=1e-9)


@pytest.mark.parametrize("planner", ["drive", "retarget", "receding"])
def test_pursuits_with_detection_errors(planner):
    """Evaders are caught, few reports are wrong, the verifier agrees, and nothing is guaranteed."""
    answer = planopt.simulate(planopt.load("pursuit_false_alarms"), planner=planner, seed=1)
    data, metrics = answer.data, answer.data["metrics"]
    assert data["outcome"] == "captured" and data["faults"] == []
    assert metrics["wrong_records"] <= 0.05 * metrics["records"] + 1
    assert not any(each["holds"] for each in data["guarantee"]["theorems"].values())
    text = data["guarantee"]["theorems"]["snapshots"]["inequalities"][0]["text"]
    assert "without the evader's name" in text


def test_reports_that_no_mote_gave_are_rejected():
    """A moved report is refused, also where it may be a false alarm."""
    facts, log = verifier_data(planopt.simulate(planopt.load("pursuit_false_alarms"), seed=1))
    assert verify_pursuit(facts, log) == []
    for column, by in (("reported_m", 3.0), ("sampled_s", 0.1), ("error_m", -1.0)):
        values = getattr(log.reports, column).copy()
        values[4] += by
        moved = replace(log, reports=replace(log.reports, **{column: values}))
        assert "report" in {each.kind for each in verify_pursuit(facts, moved)}


def test_errorless_detection_names_a_lone_evader():
    """One evader and no errors: every report is its own, as with names."""
    runs = [
        planopt.simulate(changed("pursuit_fleeing", **keys), planner="retarget", seed=2).data
        for keys in ({}, {"detection": {}})
    ]
    assert runs[0]["capture_time_s"] == pytest.approx(runs[1]["capture_time_s"], rel=1e-3)
    assert runs[1]["metrics"]["wrong_records"] == 0
