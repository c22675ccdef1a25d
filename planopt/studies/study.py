"""Run studies: many results in processes, each kept when it is finished.

A study that was stopped, however that was, goes on when it is run again with the same record.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, cast

from joblib import Parallel, delayed  # pyright: ignore[reportUnknownVariableType]

from planopt.errors import InputError
from planopt.objectives.terms.term import Term, outside_terms, register
from planopt.problems.planner_kinds import (
    PlannerKind,
    register_planner,
    registered_planners,
)
from planopt.problems.rule_kinds import register_rule, registered_rules
from planopt.studies.finished_runs import FinishedRuns

BACKENDS = ("loky",)
"""What joblib may run tasks on."""

CHECK_EVERY_S = 1.0
"""How often a worker looks for its parent."""

_WATCH = "end-with-parent"

Item = TypeVar("Item")
Shared = TypeVar("Shared")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Study(Generic[Item, Shared, Result]):
    """How each item of a study is done; the functions must be picklable.

    Attributes
    ----------
    kind
        Type of a result, as :mod:`planopt.files.typed_json` reads it back.
    prepare
        Makes what the items of one group share, from the first of them that is not finished.
    work
        Makes an item's result.
    key
        All that decides an item's result, as JSON.
    """

    kind: type[Result]
    prepare: Callable[[Item], Shared]
    work: Callable[[Item, Shared], Result]
    key: Callable[[Item], Mapping[str, Any]]


@dataclass(frozen=True)
class Finished(Generic[Result]):
    """A result, and whether the record had it already."""

    result: Result
    resumed: bool


def run_study(
    study: Study[Item, Shared, Result],
    groups: Sequence[Sequence[Item]],
    *,
    workers: int = 1,
    backend: str = "loky",
    record: FinishedRuns | None = None,
) -> Iterator[list[Finished[Result]]]:
    """Do all items; yield the results of each group, in order, when it is finished.

    Parameters
    ----------
    study
        How an item is done.
    groups
        Items that share their preparation and are done one after the other by one process.
    workers
        Processes. Results do not depend on their number, but for measured times.
    backend
        joblib backend; ``loky`` is this machine.
    record
        Where every result is kept as soon as it is there, and taken from if it is kept already.

    Raises
    ------
    InputError
        There is no worker or no such backend.
    OutputError
        The record cannot be written.
    """
    if workers < 1:
        raise InputError(f"{workers} is less than 1", key="workers")
    if backend not in BACKENDS:
        raise InputError(
            f"{backend!r} is not there", key="backend", remedy=f"use {', '.join(BACKENDS)}"
        )
    parallel = Parallel(n_jobs=workers, backend=backend, return_as="generator")
    task = cast("Callable[..., object]", delayed(_group_results))
    outside = registered_planners(), outside_terms(), registered_rules()
    jobs = [task(study, group, record, *outside, os.getpid()) for group in groups]
    return iter(cast("Iterable[list[Finished[Result]]]", parallel(jobs)))


def _group_results(
    study: Study[Item, Shared, Result],
    group: Sequence[Item],
    record: FinishedRuns | None,
    planners: Sequence[PlannerKind],
    terms: Sequence[type[Term]],
    rules: Sequence[type[Any]],
    parent: int,
) -> list[Finished[Result]]:
    """Do the items of a group, but for those that are finished."""
    if os.getpid() != parent:
        _end_with_parent(parent)
        for kind in planners:
            register_planner(kind)
        for term in terms:
            register(term)
        for rule in rules:
            register_rule(rule)
    shared: list[Shared] = []
    results: list[Finished[Result]] = []
    for item in group:
        key = None if record is None else study.key(item)
        found = None if record is None or key is None else record.find(key, study.kind)
        if found is not None:
            results.append(Finished(found, resumed=True))
            continue
        if not shared:
            shared.append(study.prepare(item))
        made = study.work(item, shared[0])
        if record is not None and key is not None:
            record.keep(key, made)
        results.append(Finished(made, resumed=False))
    return results


def _end_with_parent(parent: int) -> None:
    """End this process, without further ado, soon after the process `parent` has ended.

    A process that is killed cannot tell its workers to stop, and theirs would go on for hours.
    Calling this again changes nothing; nor does it if `parent` is not the parent of this process.
    """
    watched = any(thread.name == _WATCH for thread in threading.enumerate())
    if watched or os.getppid() != parent:
        return

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(CHECK_EVERY_S)
        os._exit(1)

    threading.Thread(target=watch, name=_WATCH, daemon=True).start()
