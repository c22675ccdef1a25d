"""What measurements tell of a problem's channel."""

from __future__ import annotations

from planopt.channel.belief import Belief
from planopt.channel.estimation.fit import fit_channel
from planopt.channel.measurements import Measurements
from planopt.channel.posterior import condition
from planopt.problems.problem import Problem


def learn(problem: Problem, measurements: Measurements) -> Belief:
    """Fit the channel of the problem's station to measurements and condition on them."""
    fit = fit_channel(measurements, problem.stations[0].site, problem.channel.fit_method)
    return Belief(fit, condition(fit.parameters, measurements))
