"""One receding-horizon step for a sum of terms: global starts, and the ladder over them."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from planopt.planning.budget import budget_from
from planopt.planning.driven import driven_starts
from planopt.planning.ground import Ground
from planopt.planning.judge import Judge
from planopt.planning.ladder import Ladder
from planopt.planning.plan import Plan, Rung, Termination, Verdict
from planopt.planning.search.start_search import Start, StartSearch
from planopt.planning.search.to_unmeasured import way_to_unmeasured
from planopt.planning.shifted import shifted_path
from planopt.planning.worth.path_worth import PathWorth, rule_missing
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
        budget = budget_from(self.problem, begun)
        shifted = shifted_path(self.problem, judge.index, situation.position_m, warm)
        starts = self._search.find_starts(situation, shifted, budget)
        way = self._way_out(situation, starts)
        if way is not None:
            out = Start(way, judge.objective(way), rule_missing(situation, way))
            if situation.measuring.takes(way).any():
                # It measures something after all: what that is worth is for all to compare.
                starts = sorted([*starts, out], key=lambda start: -start.worth)
            elif (plan := self._released(situation, judge, out, warm, begun)) is not None:
                return plan
        if self.problem.robots[0].dynamics is not None:
            starts = driven_starts(judge, situation, starts, warm)
        chosen = self.ladder.climb(situation, judge, starts, warm, budget)
        if chosen.kkt_residual is None:
            # The search predicted its places with others; whoever judges the plan will not.
            alone = PathWorth(replace(situation))(chosen.path_m)
            same = chosen.lattice_objective == chosen.objective
            found = alone if same else chosen.lattice_objective
            chosen = replace(chosen, objective=alone, lattice_objective=found)
        return judge.plan_from(chosen, wall_s=perf_counter() - begun)

    def _way_out(self, situation: Situation, starts: list[Start]) -> NDArray[np.float64] | None:
        """The way (N, 2) to the nearest unmeasured place, where no start measures anything.

        None where one does, where a term asks for more than measurements, or none is left.
        """
        terms = self.problem.terms
        if not any(term.is_measured for term in terms) or not all(
            term.is_measured or term.is_motion_cost for term in terms
        ):
            return None
        worth = PathWorth(situation)
        for start in starts:
            gains = zip(terms, worth.by_term(start.path_m), strict=True)
            if any(gain > 0.0 for term, gain in gains if term.is_measured):
                return None
        return way_to_unmeasured(situation, self.ground)

    def _released(
        self, situation: Situation, judge: Judge, start: Start, warm: Plan | None, begun_s: float
    ) -> Plan | None:
        """The plan of a start as it is; None if it is not verified."""
        if self.problem.robots[0].dynamics is not None:
            start = driven_starts(judge, situation, [start], warm)[0]
        rung = Rung.PLAN if self.ladder.polish is None else Rung.LATTICE
        found = judge.judged(
            judge.candidate(start.path_m, rung, Termination.LATTICE_ONLY, start.drive)
        )
        if found.verdict is not Verdict.VERIFIED:
            return None
        return judge.plan_from(found, wall_s=perf_counter() - begun_s)
