"""Clusters on this machine give the bits of one process, and resume what was kept."""

import signal
from importlib.util import find_spec
from pathlib import Path

import pytest
from refusals import refused
from test_finished_runs import short
from test_sweep import untimed

from planopt import compare
from planopt.studies import study

BACKENDS = [
    pytest.param(name, marks=pytest.mark.skipif(find_spec(package) is None, reason="not installed"))
    for name, package in study.PACKAGES.items()
]


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_local_cluster(backend: str, tmp_path: Path, monkeypatch) -> None:
    """Bit for bit as in this process; each worker keeps its own runs."""
    # Ray's processes give way to all others, and tests run beside this one.
    monkeypatch.setenv("RAY_worker_niceness", "0")
    before = signal.getsignal(signal.SIGTERM)
    problem = short("open_field")
    settings = {"costs_to_go": ["geodesic"], "seeds": 3}
    alone = compare(problem, [1, 2], **settings)
    seen: list[int] = []
    found = compare(
        problem,
        [1, 2],
        **settings,
        workers=2,
        backend=backend,
        finished=tmp_path,
        on_run=lambda run: seen.append(run.seed),
    )
    assert list(map(untimed, found.runs)) == list(map(untimed, alone.runs))
    assert seen == [0, 0, 1, 1, 2, 2] and found.resumed == 0
    assert signal.getsignal(signal.SIGTERM) is before
    assert compare(problem, [1, 2], **settings, finished=tmp_path).resumed == 6


@pytest.mark.parametrize("backend", list(study.PACKAGES))
def test_a_cluster_that_is_not_installed(backend: str, monkeypatch) -> None:
    monkeypatch.setattr(study, "find_spec", lambda name: None)
    with refused():
        compare(short("open_field"), [1], seeds=1, backend=backend)
