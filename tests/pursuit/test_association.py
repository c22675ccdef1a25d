"""Data association: against all possible chains, and on objects that are known."""

from itertools import product

import numpy as np
import pytest
from objects_on_grid import walk
from scipy.stats import norm

from planopt.errors import InputError
from planopt.pursuit.association import (
    AssociationModel,
    Detector,
    Reports,
    associate,
    draw_detections,
    merge_reports,
    reports_at,
)
from planopt.pursuit.service import SnapshotService

MODEL = AssociationModel(1.0, Detector(0.3, 1.0), 400.0, np.array([1.0]))


def reports_of(sampled_s, places_m, error_m=0.2):
    """Reports with one error."""
    count = len(sampled_s)
    return Reports(
        np.asarray(sampled_s, dtype=float),
        np.asarray(places_m, dtype=float),
        np.full(count, error_m),
        np.zeros(count, dtype=int),
        np.arange(count),
    )


def worth_of(owners, reports, starts_m, model):
    """Log likelihood ratio of an assignment to the one that owns nothing; None if impossible."""
    total = 0.0
    for owner, start in enumerate(starts_m):
        when, where, error = 0.0, start, 0.0
        for number in np.flatnonzero(owners == owner):
            lapse = reports.sampled_s[number] - when
            reach = model.speed_max_m_s * lapse + error + reports.errors_m[number]
            if lapse <= 0.0 or np.linalg.norm(reports.reported_m[number] - where) > reach:
                return None
            errors = [error, reports.errors_m[number]]
            spread = np.sqrt((model.speed_max_m_s * lapse) ** 2 / 2 + np.square(errors).sum() / 6)
            density = norm.pdf(reports.reported_m[number] - where, scale=spread).prod()
            rate = model.detector.false_alarms / model.area_m2
            total += np.log((1 - model.detector.miss_probability) * density / rate)
            skipped = np.ceil(lapse / model.periods_s[0] - 1e-3) - 1
            total += skipped * np.log(model.detector.miss_probability)
            when, where, error = (
                reports.sampled_s[number],
                reports.reported_m[number],
                reports.errors_m[number],
            )
    return total


@pytest.mark.parametrize("seed", range(6))
def test_against_all_assignments(seed):
    """No way to give seven reports to two evaders or to none is likelier."""
    generator = np.random.default_rng(seed)
    reports = reports_of(np.sort(generator.uniform(0.5, 6.0, 7)), generator.uniform(0, 6, (7, 2)))
    starts = generator.uniform(1, 5, (2, 2))
    best = max(
        worth
        for owners in product((-1, 0, 1), repeat=7)
        if (worth := worth_of(np.array(owners), reports, starts, MODEL)) is not None
    )
    found = associate(reports, np.zeros(2), starts, np.zeros(2), MODEL)
    assert worth_of(found, reports, starts, MODEL) == pytest.approx(best, abs=1e-9)


def owners_of(reports, starts=1):
    """Owners among evaders that were all at the origin at time 0."""
    return associate(reports, np.zeros(starts), np.zeros((1, 2)), np.zeros(starts), MODEL).tolist()


def test_what_is_out_of_reach_is_nobodys():
    """A report that no evader can have caused belongs to none; the next one still does."""
    places = [[0.5, 0.0], [9.0, 9.0], [2.5, 0.0]]
    assert owners_of(reports_of([1.0, 2.0, 3.0], places)) == [0, -1, 0]
    assert owners_of(reports_of([1.0], [[9.0, 9.0]])) == [-1]


def test_nothing_to_assign():
    """No reports, no owners."""
    assert owners_of(reports_of([], np.zeros((0, 2)))) == []


def test_shapes():
    """Starts that do not belong together are refused."""
    with pytest.raises(InputError, match="belong together"):
        owners_of(reports_of([], np.zeros((0, 2))), starts=2)


def test_on_the_grid():
    """Three objects seen by a mote in the middle, a fifth missed and two false alarms an instant.

    Four fifths of the objects' reports find their object, and few that are given to one are wrong.
    """
    service = SnapshotService(6, 1.0, 0.05, 3)
    detector = Detector(0.2, 2.0)
    right, wrong, given, real = 0, 0, 0, 0
    for seed in range(8):
        tracks = [walk(service, 0.5, 200, 100 * seed + number) for number in range(3)]
        generator = np.random.default_rng(seed)
        detections = draw_detections(service, tracks, detector, (0.0, 40.0), generator)
        reports = reports_at(service, detections, np.array([32, 32]), 10.0)
        for time_s in np.arange(10.0, 40.0, service.periods_s[0]):
            more = reports_at(service, detections, np.array([32, 32]), time_s)
            reports = merge_reports(reports, more)
        starts = np.array([track.positions_m[0] for track in tracks])
        model = AssociationModel(0.5, detector, service.side_m**2, service.periods_s)
        found = associate(reports, np.zeros(3), starts, np.zeros(3), model)
        truth = detections.objects[reports.numbers]
        right += int(((found == truth) & (truth >= 0)).sum())
        real += int((truth >= 0).sum())
        given += int((found >= 0).sum())
        wrong += int(((found >= 0) & (found != truth)).sum())
    assert right / real > 0.8
    assert wrong / given < 0.1
