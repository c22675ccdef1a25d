"""A small run and small plans of two robots that track, and of one that maps."""

from dataclasses import replace

from terms_scene import TRACKING, terms_problem

from planopt import Problem


def two_trackers(**planner: object) -> Problem:
    """Two robots of the small problem that follow its target."""
    problem = terms_problem(TRACKING, **{"horizon": 2, "max_steps": 3, **planner})
    first = problem.robots[0]
    second = replace(first, name="second", start_m=(30.0, 10.0))
    return replace(problem, robots=(first, second))
