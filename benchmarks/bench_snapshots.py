"""Small versions of ``snapshot_study.py``: slots."""

from __future__ import annotations

from snapshot_study import slots


def test_slots(benchmark):
    """A slot for the mean load breaks rounds; what keeps them is between it and the peak."""
    rows = benchmark.pedantic(lambda: list(slots(range(3, 5)))[1:], rounds=1)
    assert len(rows) == 4
    for row in rows:
        assert row[4] > 0.0 and float(row[2]) < row[5] <= row[3]
