"""No method throws anything but an InputError, on a thousand small cases."""

import itertools

import numpy as np
import pytest
from small_cases import assert_usable, small_case

from planopt import InputError
from planopt.channel import condition, fit_channel
from planopt.channel.estimation.least_squares import examine

CASES = 1000
BLOCKS = 20
ROTATED = (
    ("lemma1", "squares"),
    ("convex", "squares"),
    ("capped", "squares"),
    ("nls", "squares"),
    ("lemma1", "squares"),
    ("convex", "huber"),
    ("capped", "squares"),
    ("convex", "absolute"),
)
"""Beside reml, which has every case, each has one of these; all on every case take four times as
long."""


@pytest.mark.parametrize(
    "block", [pytest.param(n, marks=[pytest.mark.slow] if n % 4 else []) for n in range(BLOCKS)]
)
def test_every_fit_is_usable_or_refused(block):
    """Each case is fitted with finite numbers that predict finite ones, or refused by examine."""
    width = CASES // BLOCKS
    for seed in range(width * block, width * (block + 1)):
        measurements, station, forgetting_s = small_case(seed)
        methods = (("reml", "squares"), ROTATED[seed % len(ROTATED)])
        for method, loss in methods:
            try:
                fit = fit_channel(measurements, station, method, forgetting_s, loss=loss)
            except InputError:
                with pytest.raises(InputError):
                    examine(measurements, station)
                continue
            assert_usable(fit)
            near = measurements.positions_m[:3] + [[0.0, 0.0]]
            places = np.concatenate([near, near + [1.0, 3.0]])
            found = condition(fit.parameters, measurements).predict(places)
            assert np.isfinite(found.mean_db).all()
            assert np.isfinite(found.deviation_db).all()
            assert (found.deviation_db > 0.0).all()


def test_cases_are_what_they_say():
    """Among them are refused, repeated, far, rounded, censored and constant ones."""
    cases = list(itertools.islice(map(small_case, itertools.count()), 90))
    measured = [measurements for measurements, _, _ in cases]
    assert {len(m) for m in measured} >= {2, 30}
    for share in (
        np.mean([len(np.unique(m.positions_m, axis=0)) < len(m) for m in measured]),
        np.mean([m.positions_m.min() > 1e6 for m in measured]),
        np.mean([m.resolution_db.any() for m in measured]),
        np.mean([m.censored.any() for m in measured]),
        np.mean([np.ptp(m.power_dbm) == 0.0 for m in measured]),
        np.mean([m.receiver.any() for m in measured]),
    ):
        assert share > 0.08
