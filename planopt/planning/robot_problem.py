"""The problem at one time of a run, and of one robot: its own terms, and the obstacles then."""

from __future__ import annotations

from dataclasses import replace

from planopt.problems.problem import Problem


def problem_at(problem: Problem, steps: int) -> Problem:
    """Return `problem` with the obstacles that are known after so many steps.

    The problem itself where these are its obstacles.
    """
    workspace = problem.workspace
    if not workspace.timed:
        return problem
    known = workspace.known_at(steps * problem.planner.step_s)
    if known == workspace.obstacles:
        return problem
    return replace(problem, workspace=replace(workspace, obstacles=known))


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
