"""Randomly damaged files of every format: a result or one line of ours, soon, and nothing else."""

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rasterio")
pytest.importorskip("h5netcdf")
pytestmark = pytest.mark.skipif(os.name != "posix", reason="limits of processes")

from sound_files import write_inputs  # noqa: E402

PART = 250
"""Number of cases of one process."""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    write_inputs(folder)
    return folder


def run_cases(root: Path, seed: int, count: int) -> Counter[int]:
    """Run cases, in a new process where one has died; return exit codes, or fail with faults."""
    results: dict[int, dict[str, Any]] = {}
    while len(results) < count:
        first = len(results)
        part = min(PART, count - first)
        script = [sys.executable, str(Path(__file__).with_name("run_damaged.py")), str(root)]
        done = subprocess.run(
            [*script, str(seed), str(first), str(part)],
            capture_output=True,
            text=True,
            timeout=120.0 + 60.0 * part,
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        for line in map(json.loads, done.stdout.splitlines()):
            results.setdefault(line["index"], {"fault": "died"}).update(line)
        assert len(results) > first, done.stderr
        # Anything that a library writes past Python is noise.
        assert done.returncode != 0 or not done.stderr, done.stderr[-2000:]
    faults = [result for result in results.values() if result["fault"] is not None]
    assert not faults, "\n\n".join(map(str, faults))
    return Counter(result["code"] for result in results.values())


def test_sound_inputs_are_read(root: Path) -> None:
    count = len(list(root.glob("*/case.json")))
    assert set(run_cases(root, -1, count)) <= {0, 3}


@pytest.mark.parametrize(
    ("seed", "count"), [(1, 200), pytest.param(2, 10_000, marks=pytest.mark.slow)]
)
def test_damaged_files(seed: int, count: int, root: Path) -> None:
    """Some are refused and some are read; 10,000 take half an hour."""
    codes = run_cases(root, seed, count)
    assert codes[2] > count / 4 and codes[0] > count / 20, codes
