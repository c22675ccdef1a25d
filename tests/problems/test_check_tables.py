"""Problems made in Python are held to what files are, before anything is planned."""

from __future__ import annotations

from dataclasses import replace

import pytest
import shapely

from planopt.errors import InputError
from planopt.objectives import TermsObjective
from planopt.problems.library import list_problems
from planopt.problems.load import load
from planopt.problems.overrides import with_overrides
from planopt.problems.problem import Problem
from planopt.problems.tasks import MOTION
from planopt.world.workspace import Obstacle

NAN, INF = float("nan"), float("inf")


def robot(problem: Problem, **changes) -> Problem:
    """The first robot with changes."""
    return replace(problem, robots=(replace(problem.robots[0], **changes), *problem.robots[1:]))


def station(problem: Problem, **changes) -> Problem:
    """The station with changes."""
    return replace(problem, stations=(replace(problem.stations[0], **changes),))


def obstacle(problem: Problem, polygon: shapely.Polygon) -> Problem:
    """One obstacle more."""
    more = (*problem.workspace.obstacles, Obstacle("bad", polygon))
    return replace(problem, workspace=replace(problem.workspace, obstacles=more))


BOWTIE = shapely.Polygon([(20, 20), (30, 30), (30, 20), (20, 30)])

WRONG = {
    "start is text": lambda p: robot(p, start_m=("a", 1.0)),
    "start in space": lambda p: robot(p, start_m=(1.0, 1.0, 1.0)),
    "start is NaN": lambda p: robot(p, start_m=(NAN, 1.0)),
    "speed is NaN": lambda p: robot(p, speed_max_m_s=NAN),
    "speed is infinite": lambda p: robot(p, speed_max_m_s=INF),
    "threshold is NaN": lambda p: station(p, threshold_dbm=NAN),
    "threshold is infinite": lambda p: station(p, threshold_dbm=INF),
    "no station": lambda p: replace(p, stations=()),
    "no robot": lambda p: replace(p, robots=()),
    "no such fit": lambda p: replace(p, channel=replace(p.channel, fit_method="guess")),
    "spacing is NaN": lambda p: replace(p, channel=replace(p.channel, measure_spacing_m=NAN)),
    "name is a path": lambda p: replace(p, name="a/../b"),
    "obstacle crosses itself": lambda p: obstacle(p, BOWTIE),
    "obstacle is empty": lambda p: obstacle(p, shapely.Polygon()),
    "step is NaN": lambda p: replace(p, planner=replace(p.planner, step_s=NAN)),
}


@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("library", ["open_field", "outdoor_track"])
def test_what_no_file_could_say(name: str, library: str) -> None:
    """Never a plan of it, nor an error of a dependency."""
    with pytest.raises(InputError):
        with_overrides(WRONG[name](load(library)))


def test_what_no_task_asks() -> None:
    """A goal, targets and terms go with their tasks."""
    reach, track = load("open_field"), load("outdoor_track")
    for problem in (
        robot(reach, goal_m=None),
        replace(reach, robots=reach.robots * 2),
        robot(track, goal_m=(1.0, 1.0)),
        replace(track, targets=()),
        replace(track, robots=track.robots * 2),
        replace(track, objective=TermsObjective((replace(track.terms[0], weight=NAN),))),
        replace(track, objective=TermsObjective((replace(track.terms[0], form="sum"),))),
    ):
        with pytest.raises(InputError):
            with_overrides(problem)


def test_every_problem_of_the_library_passes() -> None:
    """They are as they should be."""
    for entry in list_problems():
        if entry.task not in MOTION:
            continue
        problem = load(entry.path)
        assert with_overrides(problem) == problem
