"""What one robot of a problem is asked: the problem with that robot alone."""

from __future__ import annotations

from dataclasses import replace

from planopt.problems.problem import Problem


def problem_of_robot(problem: Problem, number: int) -> Problem:
    """`problem` with robot number `number` alone."""
    return replace(problem, robots=(problem.robots[number],))
