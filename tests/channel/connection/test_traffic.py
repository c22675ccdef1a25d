"""The buffer against following it in small steps, and conservation."""

import numpy as np
import pytest

from planopt import InputError
from planopt.channel import Traffic
from planopt.channel.outage import sent_and_lost

TIMES = np.array([0.0, 1.0, 2.5, 3.0, 5.0, 6.0, 9.0])


def by_small_steps(durations, drive, traffic, step=1e-3):
    """The fluid followed in time."""
    waiting, delivered = traffic.waiting_bits, 0.0
    for duration, now in zip(durations, drive[1:], strict=True):
        for _ in range(round(duration / step)):
            waiting += traffic.source_bps * step
            sent = min(waiting, traffic.link_bps * step) if now else 0.0
            delivered += sent
            waiting = min(waiting - sent, traffic.buffer_bits)
    return delivered, waiting


@pytest.mark.parametrize(
    "traffic",
    [
        Traffic(3.0, waiting_bits=2.0, source_bps=1.0, buffer_bits=4.0),
        Traffic(1.0, source_bps=2.0, buffer_bits=3.0),
        Traffic(5.0, waiting_bits=20.0),
        Traffic(2.0, source_bps=2.0, buffer_bits=0.0),
    ],
)
def test_fluid_against_small_steps(traffic):
    """Links faster and slower than the source, with and without a buffer."""
    drives = np.random.default_rng(0).random((4, len(TIMES))) < 0.5
    delivered, lost, waiting = sent_and_lost(np.diff(TIMES), drives, traffic)
    for number, drive in enumerate(drives):
        expected = by_small_steps(np.diff(TIMES), drive, traffic)
        assert delivered[number] == pytest.approx(expected[0], abs=0.02)
        assert waiting[number] == pytest.approx(expected[1], abs=0.02)
    total = traffic.waiting_bits + traffic.source_bps * 9.0
    np.testing.assert_allclose(delivered + lost + waiting, total)
    assert (lost >= 0.0).all()


@pytest.mark.parametrize(
    ("numbers", "named"),
    [
        ((0.0,), "link_bps"),
        ((1.0, -1.0), "waiting_bits"),
        ((1.0, 0.0, -1.0), "source_bps"),
        ((1.0, 5.0, 0.0, 4.0), "waiting_bits"),
        ((1.0, 0.0, 0.0, np.nan), "waiting_bits"),
    ],
)
def test_bad_traffic(numbers, named):
    """Rates and sizes out of range."""
    with pytest.raises(InputError, match=named):
        Traffic(*numbers)
