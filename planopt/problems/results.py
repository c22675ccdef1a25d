"""Results of all tasks: a JSON object, named tables, arrays and figures, saved in one manner."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planopt.errors import A_FOLDER, InputError, path_of
from planopt.files.compare import differences, in_words
from planopt.files.tables import Column, Data, comparable, dataframe, table_text
from planopt.files.writing import replaced_results, strict_text, write_text, write_whole
from planopt.problems.tasks import task_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Contents:
    """Contents of all files of a result, except for the problem."""

    file: str  # Name of the JSON file
    data: Mapping[str, Any]
    # Columns and values by file name
    tables: Mapping[str, tuple[Sequence[Column], Data]] = field(
        default_factory=dict[str, tuple[Sequence[Column], Data]]
    )
    arrays: Mapping[str, Arrays] = field(default_factory=dict[str, Arrays])  # By file name

    def table_reasons(self, saved: Mapping[str, Data]) -> list[str]:
        """Return the differences of saved tables from the recomputed ones, line by line."""
        return [
            line
            for name, (_, data) in self.tables.items()
            for line in in_words(name, differences(comparable(saved[name]), comparable(data)))
        ]


@dataclass(frozen=True, eq=False, repr=False)
class Result(ABC):
    """Result of :func:`planopt.solve` or :func:`planopt.simulate` for a problem of any task."""

    problem: Any

    @property
    @abstractmethod
    def exit_code(self) -> int:
        """Return the exit code of the command line."""

    def __repr__(self) -> str:
        """Return a text summary of the result, line by line."""
        return "\n".join(self.words)

    @property
    def task(self) -> Any:
        """Return the :class:`planopt.extend.Task` of the problem."""
        return task_of(self.problem)

    @property
    def words(self) -> tuple[str, ...]:
        """Return a text summary of the result, line by line."""
        return tuple(self.task.result_words(self))

    def save(self, folder: Path | str) -> None:
        """Save the result to a folder that :func:`planopt.check` and ``load_result`` can read.

        Parameters
        ----------
        folder
            Folder, created if missing; a previous result in it is replaced.

        Raises
        ------
        OutputError
            The folder cannot be written; its previous content is kept.
        InputError
            The problem has parts from Python, which cannot be saved.
        """
        files: Contents = self.task.contents(self)
        with replaced_results(path_of("folder", folder, A_FOLDER), self.task.files) as new:
            for name, arrays in files.arrays.items():
                write_whole(new / name, partial(np.savez_compressed, allow_pickle=False, **arrays))
            for name, table in files.tables.items():
                write_text(new / name, table_text(*table))
            record = {**files.data, "problem_file": self.task.tables(self.problem)}
            write_text(new / files.file, strict_text(record))

    def draw(self, folder: Path, *, animation: bool = False) -> None:
        """Write the figures selected by the problem, and optionally an animation."""
        self.task.draw(self, folder, animation=animation)

    def plot(self) -> Figure:
        """Return the main figure of the result without opening a window.

        Returns
        -------
        matplotlib.figure.Figure
            Figure; ``figure.savefig("result.png")`` writes it.

        Raises
        ------
        InputError
            The task has no figures, or needs data that are not saved.
        """
        figure = self.task.main_figure(self)
        if figure is None:
            raise InputError(
                "is not available: the task has no figure, or the result was read from files",
                key="plot",
                remedy="solve or simulate again",
            )
        return figure

    def _repr_html_(self) -> str:
        """Return HTML for notebooks: the main figure, if any, and key figures."""
        summary_html = import_module("planopt.report.notebook").summary_html
        task = self.task
        return summary_html(self.problem.name, task.key_figures(self), task.main_figure(self))

    def to_dataframe(self, table: str = "steps.csv") -> Any:
        """Return a table as a pandas DataFrame.

        Parameters
        ----------
        table
            File name of the table. For motion planning, ``steps.csv`` has a row per position of
            each robot, the start first; columns of the ground truth are empty for a plan.

        Returns
        -------
        pandas.DataFrame
            One column per column of the file.

        Raises
        ------
        InputError
            The table does not exist, or pandas is not installed.
        """
        tables: Mapping[str, tuple[Sequence[Column], Data]] = self.task.contents(self).tables
        if table not in tables:
            raise InputError(
                f"is {table!r}, which is not a table of this result",
                key="table",
                remedy=f"use {', '.join(tables) or 'no table'}",
            )
        return dataframe(*tables[table])
