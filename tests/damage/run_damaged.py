"""Run planopt on damaged files, in a process whose memory and time are limited.

``python run_damaged.py ROOT SEED FIRST COUNT`` runs the cases FIRST, FIRST + 1, ... of a seed and
prints two lines of JSON for each: one when it begins, one with its exit code and its fault, which
is null if there is none. Seed -1 damages nothing.
"""

import contextlib
import io
import json
import resource
import shutil
import signal
import sys
import time
import traceback
import warnings
from pathlib import Path

import numpy as np
from damages import damaged

MEMORY_BYTES = 4 << 30
"""Limit of the address space, of which the libraries alone take one gigabyte."""

CPU_S = 30
"""Limit of the time of a case."""

LEAKS = ("codec can't", "<_io.", "object at 0x", "[Errno", "bomb", "HDF5-DIAG")
"""Words of dependencies."""


def run_case(folder: Path, seed: int, index: int, work: Path) -> tuple[str, int | None, str | None]:
    """Return the damaged file of a case, the exit code, and the fault if there is one."""
    from planopt.cli import main

    case = json.loads((folder / "case.json").read_text())
    generator = np.random.default_rng([abs(seed), index])
    name = case["damaged"][int(generator.integers(len(case["damaged"])))]
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(folder, work / "in")
    if seed >= 0:
        content = (work / "in" / name).read_bytes()
        (work / "in" / name).write_bytes(damaged(content, generator))
    places = {"folder": str(work / "in"), "out": str(work / "out")}
    printed, errors = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(errors):
            code = main([argument.format(**places) for argument in case["command"]])
    except BaseException:
        return name, None, traceback.format_exc()[-3000:]
    fault = fault_of(code, printed.getvalue(), errors.getvalue()) or fault_of_files(work, code)
    return name, code, fault


def fault_of(code: int, printed: str, errors: str) -> str | None:
    """Return the fault of an exit code and of printed text."""
    if code not in (0, 2, 3, 4):
        return f"exit code {code}"
    if code != 2:
        lines = errors.splitlines()
        noise = [one for one in lines if " cells are unknown and count as " not in one]
        return f"noise: {errors[:2000]}" if noise else None
    line = errors.removesuffix("\n")
    if printed or not line.startswith("planopt: ") or not line.isprintable() or len(line) > 2000:
        return f"not one line of ours: {printed[:500]!r} {errors[:2000]!r}"
    return f"words of a dependency: {line!r}" if any(words in line for words in LEAKS) else None


def fault_of_files(work: Path, code: int) -> str | None:
    """Return the fault of the files that are left."""
    hidden = [path.name for path in work.rglob(".*")]
    if hidden:
        return f"temporary files are left: {hidden}"
    if code == 2:
        return "an output folder in spite of an error" if (work / "out").exists() else None
    for path in (work / "out").glob("*.json"):
        if any(word in path.read_text() for word in ("NaN", "Infinity")):
            return f"{path.name} is not strict JSON"
    return None


def run(root: Path, seed: int, first: int, count: int) -> None:
    """Run some cases and print what is known of each."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    # Python ignores the signal by default, and the process would continue.
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    for category in (RuntimeWarning, UserWarning, ResourceWarning):
        warnings.simplefilter("always", category)
    folders = sorted(path for path in root.iterdir() if (path / "case.json").exists())
    for index in range(first, first + count):
        folder = folders[index % len(folders)]
        print(json.dumps({"index": index, "input": folder.name}), flush=True)
        used = time.process_time()
        resource.setrlimit(resource.RLIMIT_CPU, (int(used) + CPU_S, resource.RLIM_INFINITY))
        name, code, fault = run_case(folder, seed, index, root / f"case {first}")
        print(json.dumps({"index": index, "file": name, "code": code, "fault": fault}), flush=True)


if __name__ == "__main__":
    run(Path(sys.argv[1]), *(int(argument) for argument in sys.argv[2:5]))
