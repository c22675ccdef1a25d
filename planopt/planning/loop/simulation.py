"""The answer to one closed-loop simulation: the run and the belief it ended with."""

from __future__ import annotations

from dataclasses import dataclass

from planopt.channel.belief import Belief
from planopt.channel.fields.truth import Truth
from planopt.planning.loop.run import Outcome, Run
from planopt.planning.plan import Plan
from planopt.planning.short_results import short_run
from planopt.problems.problem import Problem


@dataclass(frozen=True)
class Simulation:
    """One closed loop.

    Attributes
    ----------
    problem
        As run (overrides applied).
    seed
        Of the truth's fading and of the measured places.
    belief
        At the end of the run.
    first_measurements
        How many of the belief's measurements were there before the run.
    run
        The log.
    plans
        The released plans, one a step, for pictures; the first is the plan at the start.
    truth
        What was driven in, for pictures.
    further_truths
        The same of further stations.
    """

    problem: Problem
    seed: int
    belief: Belief
    first_measurements: int
    run: Run
    plans: tuple[Plan, ...]
    truth: Truth
    further_truths: tuple[Truth, ...] = ()

    def __repr__(self) -> str:
        """Return what was run, how it ended, and its metrics."""
        return short_run(self.problem, self.seed, self.runs, self.metrics)

    @property
    def runs(self) -> tuple[Run]:
        """The log of the one robot, as a :class:`TeamRun` has one for each."""
        return (self.run,)

    @property
    def metrics(self) -> dict[str, float]:
        """Every metric by name."""
        return self.run.all_metrics

    @property
    def verified_rate(self) -> float:
        """Share of released steps whose plan was verified."""
        return self.run.verified_rate


def exit_code(simulation: Simulation) -> int:
    """0 reached with every released step verified, 3 some not verified, 4 not reached."""
    if simulation.run.outcome is not Outcome.REACHED:
        return 4
    return 0 if simulation.run.verified_rate == 1.0 else 3
