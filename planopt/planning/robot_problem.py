"""What one robot of a problem is asked: the problem with that robot alone, and its terms."""

from __future__ import annotations

from dataclasses import replace

from planopt.problems.problem import Problem


def problem_of_robot(problem: Problem, number: int) -> Problem:
    """`problem` with robot number `number` alone, and with the weights that it gives its terms."""
    robot = problem.robots[number]
    alone = replace(problem, robots=(robot,))
    if not robot.weights:
        return alone
    own = tuple(
        replace(term, weight=weight)
        for term, weight in zip(problem.terms, robot.weights, strict=True)
        if weight > 0.0
    )
    # Its weights are those of its terms now.
    return replace(
        alone, robots=(replace(robot, weights=()),), objective=replace(problem.objective, terms=own)
    )
