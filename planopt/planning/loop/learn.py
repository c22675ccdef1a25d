"""What measurements tell of a problem's channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from planopt.channel.belief import Belief, update
from planopt.channel.connection.connection_outcomes import calibrate_posterior
from planopt.channel.estimation.fit import fit_channel
from planopt.channel.measurements import Measurements
from planopt.channel.posterior import condition
from planopt.objectives.measuring import MeasuringRule
from planopt.planning.given import Given
from planopt.problems.problem import Problem


def learn(problem: Problem, measurements: Measurements, station: int = 0) -> Belief:
    """Fit the channel of one of the problem's stations to measurements and condition on them.

    Where the problem asks for it, the law of connection is calibrated.
    """
    site = problem.stations[station].site
    fit = fit_channel(measurements, site, problem.channel.fit_method, intervals=False)
    posterior = condition(fit.parameters, measurements)
    if problem.channel.calibration == "platt":
        posterior = calibrate_posterior(posterior, problem.stations[station].threshold_dbm)
    return Belief(fit, posterior)


def learn_stations(problem: Problem, given: Given) -> Belief:
    """What the first measurements tell of every station."""
    beliefs = [
        learn(problem, own.measurements, station) for station, own in enumerate(given.stations)
    ]
    return replace(beliefs[0], further=tuple(beliefs[1:]))


def learn_measured(problem: Problem, belief: Belief, measured: Sequence[Measurements]) -> Belief:
    """Take measurements into a belief, but for those nearer than the spacing to earlier ones.

    Parameters
    ----------
    problem
        Says the spacing.
    belief
        The belief before; returned itself where no measurement is taken in.
    measured
        Of each station, in the order in which they were taken; none where nothing was measured.
    """
    if not measured:
        return belief
    rule = MeasuringRule.of(belief.posteriors, problem.channel.measure_spacing_m)
    taken = [each.take(rule.takes(each.positions_m)) for each in measured]
    return update(belief, *taken) if any(map(len, taken)) else belief
