"""HTML pages of results of all tasks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planopt.planning.loop.results import Run, Solution
from planopt.problems.tasks import task_of
from planopt.report.page import Page
from planopt.report.page_content import comparison_page
from planopt.studies.comparison import Comparison

if TYPE_CHECKING:
    from planopt.tasks.task import TaskResult


def page_of(result: Solution | Run | Comparison | TaskResult) -> Page:
    """Return the content of the HTML page of a result."""
    task = task_of(result.problem)
    if isinstance(result, Comparison):
        return comparison_page(result, task.tables(result.problem))
    return task.page(result)
