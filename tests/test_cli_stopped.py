"""Commands that are interrupted, terminated or killed: what is left, and what goes on."""

import importlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from planopt.cli import main
from planopt.commands.options import progress, stopping
from planopt.files.writing import STAGING
from planopt.problems.library import library_folder

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals")
SLOW = pytest.mark.slow
OPEN_FIELD = (library_folder() / "open_field.toml").read_text()
COMMAND = [sys.executable, "-c", "import sys; from planopt.cli import main; sys.exit(main())"]
COMPARE = ["--horizons", "1,2", "--costs-to-go", "geodesic"]


def written(path: Path, steps: int, figures: bool = False) -> Path:
    text = OPEN_FIELD.replace("max_steps = 200", f"max_steps = {steps}")
    path.write_text(text.replace("figures = true", f"figures = {str(figures).lower()}"))
    return path


def started(*arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )


def children(pid: int) -> list[int]:
    found = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in found.read_text().split()] if found.exists() else []


def is_running(pid: int) -> bool:
    """Whether a process is there, and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def have_ended(pids: list[int]) -> bool:
    return not any(map(is_running, pids))


def waited(condition, at_most_s: float = 120.0) -> None:
    until = time.monotonic() + at_most_s
    while not condition():
        assert time.monotonic() < until, "waited in vain"
        time.sleep(0.05)


def kept_runs(out: Path) -> dict[str, int]:
    """Runs that a comparison has kept, and when; files that were being written are none."""
    return {p.name: p.stat().st_mtime_ns for p in out.glob("finished_runs/[!.]*.json")}


def hidden(folder: Path) -> list[str]:
    return [path.name for path in folder.rglob(".*")] if folder.exists() else []


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_comparison_is_stopped_with_its_workers(
    number: signal.Signals, code: int, tmp_path: Path
) -> None:
    """Exit code by the signal, no process and no temporary file left; the same command goes on."""
    problem, out = written(tmp_path / "p.toml", steps=3), tmp_path / "out"
    arguments = ["compare", problem, *COMPARE, "--seeds", "40", "--workers", "2", "--out", out]
    process = started(*arguments)
    waited(lambda: len(kept_runs(out)) >= 2)
    workers = children(process.pid)
    process.send_signal(number)
    printed, errors = process.communicate(timeout=60)
    assert process.returncode == code and printed == "" and "Traceback" not in errors
    waited(partial(have_ended, workers), 30.0)
    finished = len(kept_runs(out))
    assert finished >= 2 and not hidden(out) and not (out / "comparison.json").exists()
    seeds = 2 + finished // 2
    assert main([str(a) for a in ["compare", problem, *COMPARE, "--seeds", seeds, "--out", out]])
    data = json.loads((out / "comparison.json").read_text())
    assert 2 <= data["resumed"] <= finished and len(data["runs"]) == 2 * seeds


def test_workers_end_with_a_killed_process(tmp_path: Path) -> None:
    problem, out = written(tmp_path / "p.toml", steps=200), tmp_path / "out"
    process = started(
        *("compare", problem, "--horizons", "1", "--costs-to-go", "geodesic"),
        *("--seeds", "40", "--workers", "2", "--out", out),
    )
    waited(lambda: bool(kept_runs(out)))
    workers = children(process.pid)
    assert len(workers) >= 2
    process.kill()
    process.communicate(timeout=60)
    waited(partial(have_ended, workers), 60.0)


@pytest.mark.parametrize("delay_s", [0.0, 1.5])
def test_a_run_is_terminated(delay_s: float, tmp_path: Path) -> None:
    """A folder that was made for it is gone; an earlier result is as it was."""
    problem = tmp_path / "p.toml"
    outdoor = (library_folder() / "outdoor_map.toml").read_text()
    # The run goes on for minutes, whatever the speed of the machine.
    problem.write_text(outdoor.replace("max_steps = 60", "max_steps = 9000"))
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "run.json").write_text("{}")
    for out in (tmp_path / "old", tmp_path / "made"):
        process = started("simulate", problem, "--out", out)
        waited(lambda out=out, process=process: out.exists() or process.poll() is not None)
        time.sleep(delay_s + (0.5 if out.name == "old" else 0.0))
        process.terminate()
        process.communicate(timeout=60)
        # Before the command has begun the system ends the process itself.
        assert process.returncode in (143, -signal.SIGTERM)
        if process.returncode == 143:
            assert not (tmp_path / "made").exists()
    assert [path.name for path in (tmp_path / "old").iterdir()] == ["run.json"]


def test_signals_in_blocks() -> None:
    """Both signals reach every block; one that a callback swallowed ends the next block.

    A second termination does not disturb cleaning up, a Ctrl-C does; handlers are put back.
    """
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    for number in (signal.SIGINT, signal.SIGTERM):
        with stopping() as outer:
            with pytest.raises(KeyboardInterrupt), progress("working"):
                signal.raise_signal(number)
            assert outer == [number]
    with stopping() as received:
        # Python ignores exceptions in callbacks of imports.
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt), progress("working"):
            raise AssertionError("not entered")
        assert received == [signal.SIGTERM]
    with pytest.raises(KeyboardInterrupt), stopping() as received:
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt:
            signal.raise_signal(signal.SIGTERM)
            assert received == [signal.SIGTERM] * 2
            signal.raise_signal(signal.SIGINT)
    assert before == [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]


def test_a_signal_waits_for_an_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module that is being imported is complete before the interrupt is raised."""
    text = "import signal\nsignal.raise_signal(signal.SIGTERM)\nCOMPLETE = True\n"
    (tmp_path / "interrupted_import.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt), stopping() as received:
        module = importlib.import_module("interrupted_import")
        assert module.COMPLETE and received == []
        time.sleep(30.0)
    assert received == [signal.SIGTERM]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux")
@pytest.mark.parametrize("arguments", [["list"], ["--help"], ["show", "nothing", "--json"]])
def test_standard_output_is_full(arguments: list[str]) -> None:
    """One line on standard error, and the exit code of an error."""
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [*COMMAND, *arguments], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert ended.returncode == 2 and ended.stderr.count("\n") == 1
    assert ended.stderr.startswith("planopt: ")


def test_standard_output_is_closed() -> None:
    """A reader that goes away is no reason for a traceback."""
    with started("show", "open_field", "--json") as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        errors = process.stderr.read()
    assert process.returncode == 2
    assert errors == "planopt: cannot write to standard output: Broken pipe\n"


COMMANDS = {
    "solve": ("plan.json", ["--horizon", "3"], {"plan.png", "belief.png"}),
    "simulate": ("run.json", ["--horizon", "2"], {"run.png", "series.png", "belief.png"}),
}


TIMED = ("plan.json", "run.json", "plan.png", "series.png")
"""Files with wall times, which differ from run to run."""


def is_whole(folder: Path, references: list[Path], name: str, pictures: set[str]) -> bool:
    """Whether a folder has one of the results, with all its pictures or none, or no JSON file."""
    files = {path.name: path for path in folder.iterdir() if not path.name.startswith(".")}
    if name not in files:
        return True
    reference = references[json.loads(files[name].read_text())["seed"]]
    drawn = {other for other in files if other.endswith(".png")}
    same = all(
        path.read_bytes() == (reference / other).read_bytes()
        for other, path in files.items()
        if other not in TIMED
    )
    return (
        same
        and drawn in (pictures, set())
        and set(files) - drawn == {name, "steps.csv", "belief.npz"}
    )


@pytest.mark.parametrize("count", [1, pytest.param(40, marks=SLOW)])
@pytest.mark.parametrize("command", COMMANDS)
def test_killed_at_random_moments(command: str, count: int, tmp_path: Path, capsys) -> None:
    """While a result is replaced: the folder has the old or the new one, or no JSON file."""
    name, more, pictures = COMMANDS[command]
    problem = written(tmp_path / "p.toml", steps=3, figures=True)
    references, took = [tmp_path / "seed 0", tmp_path / "seed 1"], 0.0
    for seed, reference in enumerate(references):
        begun = time.monotonic()
        process = started(command, problem, *more, "--seed", seed, "--out", reference)
        process.communicate(timeout=300)
        took = time.monotonic() - begun
    moments = random.Random(0)
    out = tmp_path / "out"
    shutil.copytree(references[0], out)
    for index in range(count):
        process = started(command, problem, *more, "--seed", (index + 1) % 2, "--out", out)
        time.sleep(took * moments.uniform(0.2, 1.1))
        process.kill()
        process.communicate(timeout=60)
        assert is_whole(out, references, name, pictures), index
    left = list(out.glob(f"{STAGING}*"))
    assert main([command, str(problem), *more, "--out", str(out)]) in (0, 3, 4)
    assert not any(path.exists() for path in left)
    capsys.readouterr()


@pytest.mark.parametrize(("kills", "seeds"), [(3, 6), pytest.param(100, 130, marks=SLOW)])
def test_a_comparison_killed_at_random_moments(
    kills: int, seeds: int, tmp_path: Path, capsys
) -> None:
    """Killed and continued again and again: nothing is lost, and nothing driven twice."""
    problem, out = written(tmp_path / "p.toml", steps=3), tmp_path / "out"
    arguments = ["compare", problem, *COMPARE, "--seeds", seeds, "--workers", 2]
    moments, kept = random.Random(0), dict[str, int]()
    for _ in range(kills):
        process = started(*arguments, "--out", out)
        # Some time after it has added a run, or before it has begun.
        if moments.random() < 0.8:
            waited(partial(has_more_than, out, len(kept), process), 900.0)
        time.sleep(moments.uniform(0.0, 0.5))
        workers = children(process.pid)
        process.kill()
        process.communicate(timeout=60)
        waited(partial(have_ended, workers), 60.0)
        found = kept_runs(out)
        assert found.items() >= kept.items()
        kept = found
    assert main([*map(str, arguments), "--out", str(out)]) in (0, 3, 4)
    data = json.loads((out / "comparison.json").read_text())
    assert data["resumed"] == len(kept) and not hidden(out)
    found = kept_runs(out)
    assert found.items() >= kept.items() and len(found) == len(data["runs"]) == 2 * seeds
    assert main([*map(str, arguments), "--out", str(tmp_path / "whole")]) in (0, 3, 4)
    whole = json.loads((tmp_path / "whole" / "comparison.json").read_text())
    untimed = [[{**run, "step_s": None} for run in each["runs"]] for each in (data, whole)]
    assert untimed[0] == untimed[1]
    capsys.readouterr()


def has_more_than(out: Path, kept: int, process: subprocess.Popen[str]) -> bool:
    """Whether a comparison has kept more runs than that, or has ended."""
    return len(kept_runs(out)) > kept or process.poll() is not None
