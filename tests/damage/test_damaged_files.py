"""Randomly damaged files of every format: a result or one line of ours, soon, and nothing else."""

from __future__ import annotations

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

from run_damaged import fault_of, read_inputs, write_inputs  # noqa: E402

PART = 250
"""Cases of one process."""


def results_of(root: Path) -> dict[int, dict[str, Any]]:
    """What is known of each case."""
    found: dict[int, dict[str, Any]] = {}
    path = root / "results.jsonl"
    for line in path.read_text().splitlines() if path.exists() else []:
        told = json.loads(line)
        found.setdefault(told["index"], {}).update(told)
    return found


def run_cases(root: Path, seed: int, count: int) -> dict[int, dict[str, Any]]:
    """Run so many cases, in new processes wherever one has died."""
    script = Path(__file__).with_name("run_damaged.py")
    begin = 0
    while begin < count:
        part = min(PART, count - begin)
        arguments = [str(root), str(seed), str(begin), str(part)]
        done = subprocess.run(
            [sys.executable, str(script), *arguments],
            capture_output=True,
            text=True,
            timeout=120.0 + 60.0 * part,
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        results = results_of(root)
        begin = max(results, default=-1) + 1
        if done.returncode != 0:
            assert "code" not in results[begin - 1], done.stderr
            died = {"index": begin - 1, "fault": f"died: {done.returncode}\n{done.stderr[-2000:]}"}
            with (root / "results.jsonl").open("a") as stream:
                stream.write(json.dumps(died) + "\n")
    return results_of(root)


def judged(results: dict[int, dict[str, Any]], count: int) -> None:
    """No case is missing and none has a fault; print how they went."""
    inputs = {result["format"] for result in results.values()}
    print(f"{len(results)} damaged files of {len(inputs)} inputs")
    print("exit codes:", dict(Counter(result.get("code") for result in results.values())))
    print(f"longest: {max(result.get('cpu_s', 0.0) for result in results.values()):.1f} s of CPU")
    faults = [result for result in results.values() if result["fault"] is not None]
    assert sorted(results) == list(range(count))
    assert not faults, "\n\n".join(
        f"case {r['index']}, {r['format']}, {r['file']}: {r['fault']}" for r in faults
    )


def test_inputs_without_damage(tmp_path: Path) -> None:
    """None is refused: what the others find comes of the damage."""
    write_inputs(tmp_path)
    count = len(read_inputs(tmp_path))
    results = run_cases(tmp_path, seed=-1, count=count)
    judged(results, count)
    assert {result["code"] for result in results.values()} <= {0, 3}, results


def test_faults_are_seen() -> None:
    """Noise, half a result, an error that is not ours, a code that is none of the contract's."""
    assert fault_of(2, "", "planopt: a.csv: no\n") is None
    for code, printed, errors in (
        (1, "", "planopt: a.csv: no\n"),
        (0, "fine", "RuntimeWarning: overflow\n"),
        (2, "half", "planopt: a.csv: no\n"),
        (2, "", "HDF5-DIAG: 000\nplanopt: a.csv: no\n"),
        (2, "", "planopt: \x1b[31m\n"),
        (2, "", "planopt: a.tif: 'utf-8' codec can't decode byte 0x93\n"),
        (2, "", ""),
    ):
        assert fault_of(code, printed, errors) is not None


def test_300_damaged_files(tmp_path: Path) -> None:
    """The small version of the test below, on other damages."""
    write_inputs(tmp_path)
    judged(run_cases(tmp_path, seed=1, count=300), 300)


@pytest.mark.slow
def test_10000_damaged_files(tmp_path: Path) -> None:
    """About half an hour; ``-s`` shows how they went."""
    write_inputs(tmp_path)
    judged(run_cases(tmp_path, seed=2, count=10_000), 10_000)
