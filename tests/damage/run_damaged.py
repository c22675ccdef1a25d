"""Run planopt on damaged files, in a process whose memory and time are limited.

``python run_damaged.py ROOT SEED FIRST COUNT`` takes the cases FIRST, FIRST + 1, ... of a seed and
writes a line of JSON for each into ``ROOT/results.jsonl``: before it as it begins, after it with
its fault, which is null if all is well. A process that dies leaves a beginning without an end.
Seed -1 damages nothing.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from damages import damaged
from sound_files import Sound, copied, sound_files

from planopt.cli import main

MEMORY_BYTES = 4 << 30
"""Of address space, of which the libraries alone take one gigabyte."""

CPU_S = 30
"""A process that takes longer for one case is ended."""

LONGEST_MESSAGE = 2000
CODES = (0, 2, 3, 4)
LEAKS = ("codec can't", "<_io.", "object at 0x", "[Errno", "bomb")
"""Words of dependencies, which tell the user nothing."""


def run(root: Path, seed: int, first: int, count: int) -> None:
    """Run so many cases."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for category in (RuntimeWarning, UserWarning, ResourceWarning):
        warnings.simplefilter("always", category)
    inputs = read_inputs(root)
    with (root / "results.jsonl").open("a") as results:

        def tell(**line: Any) -> None:
            results.write(json.dumps(line) + "\n")
            results.flush()

        for index in range(first, first + count):
            sound, name, content = case(inputs, seed, index)
            tell(index=index, format=sound.name, file=name)
            used = time.process_time()
            limit = int(used) + CPU_S
            resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))
            code, fault = outcome(sound, name, content, root / f"case {first}")
            tell(index=index, code=code, cpu_s=time.process_time() - used, fault=fault)


def case(inputs: list[Sound], seed: int, index: int) -> tuple[Sound, str, bytes]:
    """Input, name and content of the damaged file of a case."""
    sound = inputs[index % len(inputs)]
    if seed < 0:
        return sound, sound.damaged[0], (sound.folder / sound.damaged[0]).read_bytes()
    generator = np.random.default_rng([seed, index])
    name = sound.damaged[int(generator.integers(len(sound.damaged)))]
    content = (sound.folder / name).read_bytes()
    return sound, name, damaged(content, generator)


def outcome(sound: Sound, name: str, content: bytes, folder: Path) -> tuple[int | None, str | None]:
    """Exit code of the command, and what is wrong with how it went."""
    command = copied(sound, folder)
    (folder / "in" / name).write_bytes(content)
    code: int | None = None
    thrown = ""
    with (folder / "out.txt").open("wb") as out, (folder / "err.txt").open("wb") as err:
        kept = [os.dup(1), os.dup(2)]
        sys.stdout.flush()
        os.dup2(out.fileno(), 1)
        os.dup2(err.fileno(), 2)
        try:
            code = main(command)
        except BaseException:
            thrown = traceback.format_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            for number, original in enumerate(kept, start=1):
                os.dup2(original, number)
                os.close(original)
    printed = (folder / "out.txt").read_text(errors="replace")
    errors = (folder / "err.txt").read_text(errors="replace")
    fault = thrown[-3000:] or fault_of(code, printed, errors) or fault_of_files(folder, code)
    return code, fault


def fault_of(code: int | None, printed: str, errors: str) -> str | None:
    """What is wrong with an exit code and what was printed, if anything."""
    if code not in CODES:
        return f"exit code {code}"
    if code != 2:
        return f"noise: {errors[:2000]}" if errors else None
    if printed:
        return f"printed in spite of an error: {printed[:500]}"
    one_line = errors.startswith("planopt: ") and errors.count("\n") == 1 and errors[-1] == "\n"
    if not one_line or not errors[:-1].isprintable() or len(errors) > LONGEST_MESSAGE:
        return f"not one line of ours: {errors[:2000]!r}"
    leaks = [words for words in LEAKS if words in errors]
    return f"words of a dependency: {errors[:2000]!r}" if leaks else None


def fault_of_files(folder: Path, code: int | None) -> str | None:
    """What is wrong with the files that are left, if anything."""
    hidden = [path.name for path in folder.rglob(".*")]
    if hidden:
        return f"temporary files are left: {hidden}"
    out = folder / "out"
    if code == 2:
        return "an output folder in spite of an error" if out.exists() else None
    for path in out.glob("*.json"):
        try:
            json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
        except ValueError as error:
            return f"{path.name} is not strict JSON: {error}"
    return None


def refuse(constant: str) -> None:
    """NaN and Infinity are not JSON."""
    raise ValueError(constant)


def write_inputs(root: Path) -> None:
    """Write the sound inputs, and what there is to say of each."""
    inputs = sound_files(root / "sound")
    lines = [[s.name, str(s.folder), s.damaged, s.command] for s in inputs]
    (root / "inputs.json").write_text(json.dumps(lines))


def read_inputs(root: Path) -> list[Sound]:
    """Return what `write_inputs` wrote."""
    return [
        Sound(name, Path(folder), tuple(files), tuple(command))
        for name, folder, files, command in json.loads((root / "inputs.json").read_text())
    ]


if __name__ == "__main__":
    # Python ignores it, so that the process would go on.
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    run(Path(sys.argv[1]), *(int(argument) for argument in sys.argv[2:5]))
