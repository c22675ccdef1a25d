"""One receding-horizon step for a sum of terms: global starts, and the ladder over them."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

from planopt.planning.budget import budget_from
from planopt.planning.driven import driven_starts
from planopt.planning.ground import Ground
from planopt.planning.judge import Judge
from planopt.planning.ladder import Ladder
from planopt.planning.plan import Plan
from planopt.planning.search.start_search import StartSearch
from planopt.planning.shifted import shifted_path
from planopt.planning.worth.path_worth import PathWorth
from planopt.planning.worth.situation import Situation
from planopt.problems.problem import Problem


class HorizonPlanner:
    """Plans for one robot of a problem whose objective is a sum of terms.

    Parameters
    ----------
    problem
        With one robot; its planner settings say how.
    ground
        Its geometry.
    thorough
        Follow starts of several parts of the reachable places, polish the best twice, and take it,
        instead of the first that is verified.

    Attributes
    ----------
    ladder
        What makes plans of starts.
    """

    def __init__(self, problem: Problem, ground: Ground, thorough: bool = False) -> None:
        self.problem = problem
        self.ground = ground
        self._search = StartSearch(problem, ground, thorough)
        self.ladder = Ladder(problem, ground, thorough)

    def plan(self, situation: Situation, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is.

        Parameters
        ----------
        situation
            What is known.
        judge
            What candidates are judged by; its objective is the situation's worth.
        warm
            The plan that led here, one step old; only used if it was verified.
        """
        begun = perf_counter()
        shifted = shifted_path(self.problem, judge.index, situation.position_m, warm)
        starts = self._search.find_starts(situation, shifted)
        if self.problem.robots[0].dynamics is not None:
            starts = driven_starts(judge, situation, starts, warm)
        budget = budget_from(self.problem, begun)
        chosen = self.ladder.climb(situation, judge, starts, warm, budget)
        if chosen.kkt_residual is None:
            # The search predicted its places with others; whoever judges the plan will not.
            alone = PathWorth(replace(situation))(chosen.path_m)
            same = chosen.lattice_objective == chosen.objective
            found = alone if same else chosen.lattice_objective
            chosen = replace(chosen, objective=alone, lattice_objective=found)
        return judge.plan_from(chosen, wall_s=perf_counter() - begun)
