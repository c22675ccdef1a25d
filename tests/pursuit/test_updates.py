"""Sparse and directed updates: motes that apply floods know what full updates tell pursuers."""

import numpy as np
import pytest

import planopt
from planopt.problems.tasks import problem_from
from planopt.pursuit import SnapshotService, Track, record_floods, snapshot


def walk(side_m, speed_m_s, seed, steps=240):
    """A random walk in a square that rests now and then, one step a second."""
    generator = np.random.default_rng(seed)
    moves = generator.normal(0.0, speed_m_s, (steps, 2)) * (generator.random((steps, 1)) < 0.7)
    places = np.cumsum(np.vstack([generator.uniform(0.3, 0.7, 2) * side_m, moves]), axis=0)
    return Track(np.arange(steps + 1.0), np.abs(places - side_m * np.round(places / side_m)))


def test_floods_inform_motes_like_full_updates():
    """Motes keep what floods say, and silence means that nothing changed; also where it matters."""
    service = SnapshotService(4, 4.0, 0.1, 2)
    track, speed_m_s = walk(service.side_m, 2.0, 1), 3.0
    pursuer = walk(service.side_m, 1.2, 2)
    moved_m = np.linalg.norm(np.diff(pursuer.positions_m, axis=0), axis=1)
    assert moved_m.max() > speed_m_s  # The walk is then slowed down
    pursuer = Track(pursuer.times_s * moved_m.max() / speed_m_s, pursuer.positions_m)
    blocks = {}
    for rule in ("full", "sparse", "directed"):
        receivers = [(pursuer, speed_m_s)]
        floods = list(record_floods(service, track, 200.0, rule, receivers))
        blocks[rule] = sum(int((area[1] - area[0] + 1).prod()) for *_, area in floods)
        checked = 0
        for time_s in np.arange(15.0, 200.0, 1.7):
            now = snapshot(service, track, time_s)
            mote = service.cells(pursuer.at(np.array(time_s)), 0)
            for level in np.flatnonzero(now.shown_at(mote)).tolist():
                last = service.sample_numbers(time_s)[level]
                known = [
                    (number, cell, present)
                    for each, number, cell, present, area in floods
                    if each == level and number <= last
                    if (area[0] <= mote).all() and (mote <= area[1]).all()
                ]
                number, cell, present = known[-1]
                assert present and (cell == now.cells[level]).all()
                told_m = service.reported_m(track.at(number * service.periods_s[level]), level)
                np.testing.assert_array_equal(told_m, now.reported_m[level])
                checked += 1
        assert checked > 300
    assert blocks["directed"] < 0.8 * blocks["sparse"] and blocks["sparse"] < blocks["full"]


def changed(name, **network):
    """A library problem with other keys in [network], and no required guarantee."""
    library = planopt.load(name)
    tables = library.tables()
    tables["network"] |= network
    tables["pursuit"].pop("guarantee", None)
    return problem_from(tables, folder=library.file.parent, file=None)


def test_all_rules_lead_to_the_same_pursuit():
    """Only the number of blocks depends on the rule."""
    runs = [
        planopt.simulate(changed("pursuit_directed", updates=rule), seed=4).data
        for rule in ("full", "sparse", "directed")
    ]
    times = [run["capture_time_s"] for run in runs]
    assert times[0] == times[1] == times[2] and not any(run["faults"] for run in runs)
    full, sparse, directed = (run["metrics"]["report_blocks"] for run in runs)
    assert directed < 0.1 * full and sparse < full


@pytest.mark.parametrize("keys", [{"loss_probability": 0.1}, {"detection": {}}])
def test_silence_must_mean_no_change(keys):
    """Sparse updates are refused where a report may be missing for another reason."""
    with pytest.raises(planopt.InputError, match=r"network\.updates"):
        changed("pursuit_directed", **keys)
