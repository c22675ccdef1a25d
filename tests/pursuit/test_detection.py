"""Misses and false alarms: how often, and which reports a mote has of them."""

import numpy as np
import pytest
from objects_on_grid import walk

from planopt.errors import InputError
from planopt.pursuit.association import Detector, draw_detections, merge_reports, reports_at
from planopt.pursuit.knowledge import snapshot
from planopt.pursuit.service import SnapshotService

SERVICE = SnapshotService(5, 1.0, 0.05, 2)


def drawn(detector, seed=0, objects=2, service=SERVICE):
    """Detections of some objects over 60 s, and their tracks."""
    tracks = [walk(service, 1.0, 300, number) for number in range(objects)]
    generator = np.random.default_rng(seed)
    return draw_detections(service, tracks, detector, (-10.0, 60.0), generator), tracks


def test_rates():
    """Misses and false alarms are as often as stated, and false alarms are anywhere."""
    found, _ = drawn(Detector(0.3, 2.0))
    instants = 70.0 / SERVICE.periods_s[0]
    real = found.objects >= 0
    assert real.sum() / (2 * instants) == pytest.approx(0.7, abs=0.07)
    assert (~real).sum() / instants == pytest.approx(2.0, abs=0.25)
    assert abs(found.positions_m[~real].mean(axis=0) - SERVICE.side_m / 2).max() < 1.5
    assert (np.diff(found.sampled_s) >= 0.0).all()


@pytest.mark.parametrize("divisor", [1, 3])
def test_perfect_detection_tells_the_snapshot(divisor):
    """Without misses and false alarms, the freshest report of every mote is the snapshot's."""
    service = SnapshotService(5, 1.0, 0.05, 2, rate_divisor=divisor)
    found, (track,) = drawn(Detector(), objects=1, service=service)
    for time_s in (3.0, 20.02, 44.7):
        known = snapshot(service, track, time_s)
        for mote in np.random.default_rng(1).integers(0, 32, (40, 2)):
            reports = reports_at(service, found, mote, time_s)
            level = int(known.shown_at(mote).argmax())
            assert reports.levels[-1] == level
            assert reports.sampled_s[-1] == pytest.approx(known.sampled_s[level])
            np.testing.assert_allclose(reports.reported_m[-1], known.reported_m[level])
            off = reports.reported_m - found.positions_m[reports.numbers]
            assert (np.linalg.norm(off, axis=1) <= reports.errors_m + 1e-12).all()
            assert len(set(reports.numbers.tolist())) == len(reports)


def test_merged_reports_keep_the_finer_of_two():
    """A detection that two motes tell is kept once, from the finer level."""
    found, (track,) = drawn(Detector(), objects=1)
    mote = SERVICE.cells(track.at(np.array(30.0)), 0)
    near, far = (reports_at(SERVICE, found, place, 30.0) for place in (mote, 31 - mote))
    both = merge_reports(far, near)
    np.testing.assert_array_equal(merge_reports(near, far).levels, both.levels)
    assert len(set(both.numbers.tolist())) == len(both)
    assert (np.diff(both.sampled_s) >= 0.0).all()
    for number, level in zip(near.numbers, near.levels, strict=True):
        assert both.levels[both.numbers == number] <= level
    empty = reports_at(SERVICE, drawn(Detector(), objects=0)[0], mote, 30.0)
    assert len(empty) == len(merge_reports(empty, empty)) == 0


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"miss_probability": 1.0}, "miss_probability"),
        ({"miss_probability": -0.1}, "miss_probability"),
        ({"false_alarms": float("nan")}, "false_alarms"),
    ],
)
def test_bad_detector(options, key):
    """Each number out of range is named."""
    with pytest.raises(InputError, match=f"key {key}"):
        Detector(**options)
