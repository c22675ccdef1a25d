"""Small versions of ``snapshot_study.py``: slots and lost hops."""

from __future__ import annotations

from snapshot_study import hops, slots


def test_slots(benchmark):
    """A slot for the mean load breaks rounds; what keeps them is between it and the peak."""
    rows = benchmark.pedantic(lambda: list(slots(range(3, 5)))[1:], rounds=1)
    assert len(rows) == 8
    for row in rows:
        assert row[5] > 0.0 and float(row[3]) < row[6] <= row[4]


def test_hops(benchmark):
    """Without losses nothing is late; with them repeats and waiting heads leave out less."""
    rows = benchmark.pedantic(lambda: list(hops(4, 1, 0))[1:], rounds=1)
    late = {(row[0], row[1]): row[2] + row[3] for row in rows}
    names = list(dict.fromkeys(row[0] for row in rows))
    assert all(late[name, 0.0] == 0.0 for name in names)
    assert late[names[-1], 0.1] < 0.2 * late[names[0], 0.1]
