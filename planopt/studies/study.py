"""Parallel execution of studies, which can be resumed from one file per finished run."""

import hashlib
import json
import logging
import os
import platform
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from joblib import (
    Parallel,
    delayed,  # pyright: ignore[reportUnknownVariableType]
    parallel_config,
)

from planopt.errors import InputError, NoPlanError
from planopt.files.reading import read_bytes, read_text
from planopt.files.tables import decoded, encoded
from planopt.files.writing import remove_remains, strict_text, write_text
from planopt.objectives.terms.term import Term, outside_terms, register
from planopt.problems.library import FILE_KEYS
from planopt.problems.objective import RULES
from planopt.problems.problem import Problem
from planopt.problems.settings import PLANNERS, PlannerKind, register_planner
from planopt.problems.tasks import TaskProblem, task_of

UNDECIDING = ("report", "compare")  # Tables of a problem file that do not affect a run
LIBRARIES = ("casadi", "clarabel", "numpy", "scipy", "shapely")
"""Packages whose version may affect a result."""

Value = TypeVar("Value")

AnyProblem = Problem | TaskProblem


@dataclass(frozen=True)
class FinishedRuns:
    """Folder of finished runs, one file each."""

    folder: Path  # Created with the first stored run

    def find(self, key: Mapping[str, Any], kind: type[Value]) -> Value | None:
        """Return the result stored under `key`; None if it is missing or damaged."""
        found = _read_record(self._file(key), kind)
        return None if found is None or found[0] != key else found[1]

    def all(self, kind: type[Value]) -> list[Value]:
        """Return all stored results of a type; damaged ones are skipped."""
        # Hidden files are unfinished, either in progress or left by a killed process.
        files = sorted(self.folder.glob("[!.]*.json"))
        found = (_read_record(file, kind) for file in files)
        return [record[1] for record in found if record is not None]

    def has(self, key: Mapping[str, Any]) -> bool:
        """Return whether a file for `key` exists."""
        return self._file(key).is_file()

    def keep(self, key: Mapping[str, Any], result: object) -> None:
        """Store a result atomically."""
        write_text(self._file(key), strict_text({"key": key, "result": encoded(result)}))

    def tidy(self) -> None:
        """Remove unfinished files of killed processes."""
        remove_remains(self.folder)

    def _file(self, key: Mapping[str, Any]) -> Path:
        return self.folder / f"{_digest(strict_text(key).encode())[:32]}.json"


def _read_record(file: Path, kind: type[Value]) -> tuple[Any, Value] | None:
    """Return the key and the result in a file; None if it is missing or damaged."""
    try:
        record = json.loads(read_text(file))
        return record["key"], decoded(kind, record["result"])
    except (InputError, ValueError, KeyError, TypeError, RecursionError):
        return None


def shared_data(item: tuple[AnyProblem, int]) -> Any:
    """Return the data shared by all settings of a problem and seed, or why there are none."""
    problem, seed = item
    try:
        return task_of(problem).shared(problem, seed)
    except NoPlanError as error:
        return error


def run_key(problem: AnyProblem, seed: int) -> dict[str, Any]:
    """Return the key that determines a run's result: problem, seed and program."""
    tables = task_of(problem).tables(problem)
    return {"problem": _deciding(tables), "seed": seed, "program": dict(program())}


def digest_of_tables(tables: Mapping[str, Any]) -> str:
    """Return a digest of a problem and the content of its files."""
    return _digest(strict_text(_deciding(tables)).encode())


def _deciding(tables: Mapping[str, Any]) -> Any:
    """Return the tables that affect a run, with the content of the problem's files."""
    return _with_contents({key: each for key, each in tables.items() if key not in UNDECIDING})


def _with_contents(value: Any, name: str = "") -> Any:
    """Return `value` with file names replaced by digests of the files' content."""
    if isinstance(value, Mapping):
        table = cast("Mapping[str, Any]", value)
        return {key: _with_contents(part, key) for key, part in table.items()}
    if isinstance(value, list | tuple):
        return [_with_contents(part) for part in cast("list[Any]", value)]
    if name in FILE_KEYS and isinstance(value, str):
        return _digest(read_bytes(Path(value)))
    return value


@cache
def program() -> tuple[tuple[str, str], ...]:
    """Return package versions, and a digest of the source code."""
    package = Path(__file__).parents[1]
    source = b"".join(path.read_bytes() for path in sorted(package.rglob("*.py")))
    return (
        ("planopt", version("planopt")),
        ("source", _digest(source)),
        *((name, version(name)) for name in LIBRARIES),
    )


def cpu_name() -> str:
    """Return the processor's name, if known."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    for line in lines:
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


CHECK_EVERY_S = 1.0  # Interval in seconds at which a worker checks that its parent is alive

Item = TypeVar("Item")
Shared = TypeVar("Shared")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Study(Generic[Item, Shared, Result]):
    """Picklable functions that compute the items of a study."""

    kind: type[Result]  # Type of a result, as :mod:`planopt.files.tables` decodes it
    # Computes the data common to a group, from its first unfinished item
    prepare: Callable[[Item], Shared]
    work: Callable[[Item, Shared], Result]  # Computes an item's result
    key: Callable[[Item], Mapping[str, Any]]  # JSON data that determine an item's result


def run_study(
    study: Study[Item, Shared, Result],
    groups: Sequence[Sequence[Item]],
    *,
    workers: int = 1,
    backend: str = "loky",
    record: FinishedRuns | None = None,
) -> Iterator[list[tuple[Result, bool]]]:
    """Yield the results of each finished group in order, each flagged if read from the record."""
    if workers < 1:
        raise InputError(
            f"is {workers}, should be at least 1",
            key="workers",
            remedy="give the number of processes",
        )
    require_backend(backend)
    outside = tuple(PLANNERS.registered.values()), outside_terms(), tuple(RULES.registered.values())
    jobs = [(study, group, record, *outside, os.getpid()) for group in groups]
    results = BACKENDS[backend](_group_results, jobs, workers)
    if record is None:
        return results
    return _recorded(study, groups, record, results, elsewhere=backend != "loky")


def _recorded(
    study: Study[Item, Shared, Result],
    groups: Sequence[Sequence[Item]],
    record: FinishedRuns,
    results: Iterator[list[tuple[Result, bool]]],
    *,
    elsewhere: bool,
) -> Generator[list[tuple[Result, bool]]]:
    """Yield results, store results from other machines, and finally remove partial files."""
    record.tidy()
    try:
        for group, found in zip(groups, results, strict=True):
            for item, (one, _) in zip(group, found, strict=True) if elsewhere else ():
                key = study.key(item)
                if not record.has(key):
                    record.keep(key, one)
            yield found
    finally:
        record.tidy()


def _on_joblib(
    work: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], workers: int, **settings: Any
) -> Iterator[Any]:
    """Yield results in order, computed by processes of joblib's current backend."""
    parallel = Parallel(n_jobs=workers, return_as="generator", **settings)
    task = cast("Callable[..., object]", delayed(work))
    return iter(cast("Any", parallel([task(*job) for job in jobs])))


def _on_loky(
    work: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], workers: int
) -> Iterator[Any]:
    # Workers watch their parent from the beginning, since idle ones would survive for minutes.
    watch = {"initializer": _end_with_parent, "initargs": (os.getpid(),)}
    return _on_joblib(work, jobs, workers, backend="loky", **watch)


def _on_dask(
    work: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], workers: int
) -> Generator[Any]:
    dask, distributed = (cast("Any", import_module(name)) for name in ("dask", "distributed"))
    local = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": None}
    if dask.config.get("scheduler-address", None) is not None:
        local = {}
    with (
        distributed.Client(**local, **({"silence_logs": logging.ERROR} if local else {})),
        parallel_config(backend="dask"),
    ):
        yield from _on_joblib(work, jobs, workers)


def _on_ray(
    work: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], workers: int
) -> Generator[Any]:
    """Yield results of Ray tasks one by one; Ray's joblib backend lacks this."""
    # Usage statistics are disabled unless the user enables them.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    ray = cast("Any", import_module("ray"))
    # Workers must find the user's modules, which may register terms.
    found = {"env_vars": {"PYTHONPATH": os.pathsep.join(sys.path)}}
    local = (
        {}
        if "RAY_ADDRESS" in os.environ
        else {"num_cpus": workers, "include_dashboard": False, "runtime_env": found}
    )
    running = ray.is_initialized()
    quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
    handler = signal.getsignal(signal.SIGTERM)
    with nullcontext() if running else ray.init(**local, **quiet):
        if threading.current_thread() is threading.main_thread():
            # Ray replaces the signal handler that ends a comparison cleanly.
            signal.signal(signal.SIGTERM, handler)
        task = ray.remote(num_cpus=1)(work)
        for result in [task.remote(*job) for job in jobs]:
            try:
                yield ray.get(result)
            except ray.exceptions.RayTaskError as error:
                raise error.cause from None


BACKENDS: Mapping[str, Callable[..., Iterator[Any]]] = {
    "loky": _on_loky,
    "dask": _on_dask,
    "ray": _on_ray,
}
"""Backends by name: ``loky`` for this machine, others for the package that manages a cluster."""
PACKAGES = {"dask": "distributed", "ray": "ray"}
"""Package that a backend requires in addition to joblib."""


def require_backend(backend: str, key: str = "backend") -> None:
    """Raise an InputError if a backend is unknown or its package is not installed."""
    if backend not in BACKENDS:
        raise InputError(
            f"is {backend!r}, which is not a known backend",
            key=key,
            remedy=f"use {', '.join(BACKENDS)}",
        )
    if find_spec(PACKAGES.get(backend, "joblib")) is None:
        raise InputError(
            f"is {backend}, which is not installed",
            key=key,
            remedy=f"pip install 'planopt[{backend}]'",
        )


def _group_results(
    study: Study[Item, Shared, Result],
    group: Sequence[Item],
    record: FinishedRuns | None,
    planners: Sequence[PlannerKind],
    terms: Sequence[type[Term]],
    rules: Sequence[type[Any]],
    parent: int,
) -> list[tuple[Result, bool]]:
    """Return the results of a group; unfinished items are computed."""
    if os.getpid() != parent:
        for kind in planners:
            register_planner(kind)
        for term in terms:
            register(term)
        for rule in rules:
            RULES.add(rule.kind, rule)
    shared: list[Shared] = []
    results: list[tuple[Result, bool]] = []
    for item in group:
        found = None if record is None else record.find(study.key(item), study.kind)
        resumed = found is not None
        if found is None:
            if not shared:
                shared.append(study.prepare(item))
            found = study.work(item, shared[0])
            if record is not None:
                record.keep(study.key(item), found)
        results.append((found, resumed))
    return results


def _end_with_parent(parent: int) -> None:
    """End this process soon after its parent process has ended."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(CHECK_EVERY_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
