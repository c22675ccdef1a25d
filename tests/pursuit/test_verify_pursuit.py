"""The verifier of pursuits: honest runs pass, every kind of corruption is found for its reason."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import planopt
from planopt.pursuit import (
    Chase,
    DesignData,
    SnapshotService,
    Theorem,
    capture_guarantees,
    certify,
    verify_guarantees,
    verify_pursuit,
)
from planopt.tasks.pursuit import claims, verifier_data

LIBRARY = ("pursuit_static", "pursuit_fleeing", "pursuit_obstacles", "pursuit_several")


@cache
def logged(name, seed=0, planner="drive"):
    """A simulated library problem as the verifier sees it, and the claims of its run."""
    answer = planopt.simulate(planopt.load(name), planner=planner, seed=seed)
    return *verifier_data(answer), claims(answer), answer.data["guarantee"]["detour"]


@pytest.mark.parametrize("name", LIBRARY)
@pytest.mark.parametrize(("seed", "planner"), [(1, "drive"), (2, "retarget"), (3, "receding")])
def test_honest_runs_pass(name, seed, planner):
    """All planners on all library problems, several seeds."""
    facts, log, claims, detour = logged(name, seed, planner)
    assert verify_pursuit(facts, log) == []
    assert verify_guarantees(facts, log, claims, detour) == []


def changed(array, index, by):
    """A copy of an array with something added to an entry."""
    array = array.copy()
    array[index] += by
    return array


def reports(**changes):
    """A corruption of reports: each change is a function of a column."""

    def corrupt(facts, log):
        found = {key: change(getattr(log.reports, key)) for key, change in changes.items()}
        return facts, replace(log, reports=replace(log.reports, **found))

    return corrupt


def states(index, by, pursuer=0):
    def corrupt(facts, log):
        own = list(log.states)
        own[pursuer] = changed(own[pursuer], index, by)
        return facts, replace(log, states=tuple(own))

    return corrupt


def entries(key, index, by):
    return lambda facts, log: (facts, replace(log, **{key: changed(getattr(log, key), index, by)}))


def stricter(**changes):
    return lambda facts, log: (replace(facts, **changes), log)


def started_exactly(facts, log):
    return replace(facts, evaders=(replace(facts.evaders[0], start_radius_m=0.0),)), log


def shortened(facts, log):
    reports = log.reports
    kept = reports.time_s < log.times_s[-2]
    parts = {key: getattr(reports, key)[kept] for key in vars(reports)}
    return facts, replace(
        log,
        times_s=log.times_s[:-1],
        states=tuple(each[:-1] for each in log.states),
        aims_m=log.aims_m[:, :-1],
        chased=log.chased[:, :-1],
        evaders_m=log.evaders_m[:, :-1],
        capture_s=np.full_like(log.capture_s, np.inf),
        captors=np.full_like(log.captors, -1),
        reports=replace(reports, **parts),
    )


MUTANTS = [
    ("pursuit_fleeing", entries("times_s", 4, 0.01), "time"),
    ("pursuit_fleeing", entries("evaders_m", (0, 40, 1), np.nan), "motion"),
    ("pursuit_fleeing", started_exactly, "start"),
    ("pursuit_static", entries("evaders_m", (0, slice(None), 0), 300.0), "start"),
    ("pursuit_fleeing", entries("evaders_m", (0, 40, 0), 0.9), "speed"),
    ("pursuit_fleeing", states((40, 0), 0.9), "speed"),
    ("pursuit_fleeing", states((40, 1), 0.01), "aim"),
    ("pursuit_fleeing", entries("aims_m", (0, 40, 1), 5.0), "aim"),
    ("pursuit_fleeing", entries("aims_m", (0, slice(None), 0), 5.0), "aim"),
    ("pursuit_several", states((40, 2), 0.01, pursuer=2), "motion"),
    ("pursuit_several", states((slice(40, None), 1), 0.01, pursuer=2), "motion"),
    ("pursuit_static", stricter(bounds_m=(50.0, 0.0, 640.0, 640.0)), "bounds"),
    ("pursuit_obstacles", stricter(clearance_m=2.5), "clearance"),
    ("pursuit_fleeing", reports(reported_m=lambda x: changed(x, (1, 0), 10.0)), "report"),
    ("pursuit_fleeing", reports(error_m=lambda x: changed(x, 0, -1.0)), "report"),
    ("pursuit_fleeing", reports(sampled_s=lambda x: changed(x, 1, 0.3)), "report"),
    ("pursuit_fleeing", reports(time_s=lambda x: changed(x, 1, 0.05)), "report"),
    ("pursuit_fleeing", reports(evader=lambda x: x, time_s=lambda x: x[::-1]), "report"),
    ("pursuit_fleeing", entries("chased", (0, 3), -1), "chase"),
    ("pursuit_several", entries("capture_s", 0, -5.0), "chase"),
    ("pursuit_fleeing", entries("capture_s", 0, -5.0), "capture"),
    ("pursuit_fleeing", entries("capture_s", 0, 1000.0), "capture"),
    ("pursuit_static", stricter(capture_radius_m=20.0), "capture"),
    ("pursuit_static", stricter(capture_radius_m=6.0), "capture"),
    ("pursuit_fleeing", entries("captors", 0, -1), "capture"),
    ("pursuit_several", entries("captors", 0, 1), "capture"),
    ("pursuit_fleeing", shortened, "end"),
]


@pytest.mark.parametrize(("name", "corrupt", "kind"), MUTANTS)
def test_corrupted_runs_are_rejected(name, corrupt, kind):
    facts, log, _, _ = logged(name)
    facts, log = corrupt(facts, log)
    assert kind in {each.kind for each in verify_pursuit(facts, log)}


def test_a_coarser_level_than_the_finest_is_rejected():
    """A report of an older round of a coarser level is one that the service does give elsewhere."""
    facts, log, _, _ = logged("pursuit_fleeing")
    lossy = replace(facts, service=replace(facts.service, loss_probability=0.5))
    service, row = facts.service, 1
    found = []
    for level in range(service.levels + 1):
        lasts_s = service.hops_per_round * service.frame_s * 2**level
        sampled_s = np.floor((log.reports.time_s[row] - lasts_s) / lasts_s + 1e-9) * lasts_s
        place = log.evader_at(0, np.array([sampled_s]))[0]
        side_m = service.mote_spacing_m * 2.0 ** max(0, level - service.bits_per_axis)
        told_m = (np.floor(place / side_m) + 0.5) * side_m
        columns = {"sampled_s": sampled_s, "error_m": np.sqrt(0.5) * side_m, "reported_m": told_m}
        arrays = {key: getattr(log.reports, key).copy() for key in columns}
        for key, value in columns.items():
            arrays[key][row] = value
        changed_log = replace(log, reports=replace(log.reports, **arrays))
        kinds = [
            {each.kind for each in verify_pursuit(data, changed_log)} for data in (facts, lossy)
        ]
        found.append(("report" in kinds[0], "report" in kinds[1]))
    # Finer levels do not show the evader, one level is used, coarser ones need a loss.
    assert found.count((False, False)) == 1
    used = found.index((False, False))
    assert found[:used] == [(True, True)] * used
    assert found[used + 1 :] == [(True, False)] * (service.levels - used)


def test_false_guarantees_are_rejected():
    """A small capture radius, a short time, a small detour factor and a broken promise."""
    facts, log, claims, detour = logged("pursuit_fleeing")
    kinds = {each.kind for each in verify_guarantees(facts, log, claims, detour)}
    assert kinds == set()
    small = replace(facts, capture_radius_m=12.0)
    assert verify_guarantees(small, log, claims, detour)
    short = tuple(replace(each, capture_time_s=0.9 * each.capture_time_s) for each in claims)
    assert verify_guarantees(facts, log, short, detour)
    slow = replace(facts, pursuers=(replace(facts.pursuers[0], speed_max_m_s=2.1),))
    assert verify_guarantees(slow, log, claims, detour)
    late = replace(log, capture_s=np.full(1, np.inf), times_s=1e3 * log.times_s)
    assert verify_guarantees(facts, late, claims, detour)
    facts, log, claims, detour = logged("pursuit_obstacles")
    assert verify_guarantees(facts, log, claims, 0.5 * detour)
    claimed = tuple(replace(each, holds=True) for each in claims)
    assert verify_guarantees(facts, log, claimed, detour)


@pytest.mark.parametrize("theorem", list(Theorem))
def test_formulas_agree_with_the_planner(theorem):
    """Two implementations of the theorems: inequalities, floors, stages and times agree."""
    generator = np.random.default_rng(5)
    compared = 0
    for _ in range(40):
        evader, spacing = generator.uniform(0.5, 2.0), generator.uniform(2.0, 20.0)
        chase = Chase(evader, evader * generator.uniform(1.5, 6.0), generator.uniform(0.0, 2.0))
        frame_s = generator.uniform(0.001, 0.05) * spacing / evader
        bits, divisor = int(generator.integers(3, 9)), int(generator.integers(1, 4))
        service = SnapshotService(8, spacing, frame_s, bits, rate_divisor=divisor)
        found = capture_guarantees(chase, service.bounds)[theorem]
        radius_m, first_m = 1.2 * found.floor_m if found.holds else 50.0, 40.0 * spacing
        data = DesignData(
            *(chase.evader_speed_m_s, chase.pursuer_speed_m_s, chase.stage_delay_s, spacing),
            *(1e9, 0.0, 0.0, 9, 1, 0.0, first_m, radius_m, 1e9),
        )
        proof = certify(data, theorem, frame_s / 9, divisor, bits)
        needs = list(proof[1:-2])
        assert [each.words for each in needs] == [each.words for each in found.inequalities]
        assert [each.left for each in needs] == pytest.approx(
            [each.left for each in found.inequalities]
        )
        assert proof[-2].left == pytest.approx(found.floor_m, rel=1e-9)
        lasts_s = found.capture_time_s(first_m, radius_m)
        assert proof[-1].left == pytest.approx(lasts_s, rel=1e-9)
        compared += np.isfinite(lasts_s)
    assert compared >= 10
