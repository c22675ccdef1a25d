"""Which parameters the measurements hardly determine, and what is known of them, in words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from planopt.channel.estimation.profile import WORDS, ProfiledParameter, interval_words
from planopt.channel.estimation.ridge import AXES, Ridge
from planopt.channel.mean_model import PRIOR_N_PL_STD
from planopt.channel.parameters import ChannelParameters

WEAK_SHARE = 0.5
"""A deviation or distance whose standard error is more than this share of itself is hardly
determined: the ends of its 95 % interval are a factor of seven apart."""

Z_95 = 1.959964

Intervals = Mapping[str, tuple[float, float]]


def weak_parameters(
    parameters: ChannelParameters, standard_errors: Mapping[str, float], n_pl_is_assumed: bool
) -> tuple[str, ...]:
    """Names of the parameters with a standard error that is known, but large.

    That of n_PL is where it exceeds the deviation of its prior: it is as well known without
    measurements.
    """
    weak = [
        name
        for name in AXES
        if WEAK_SHARE * getattr(parameters, name) < standard_errors[name] < math.inf
    ]
    if not n_pl_is_assumed and PRIOR_N_PL_STD < standard_errors["n_pl"] < math.inf:
        weak.insert(0, "n_pl")
    return tuple(weak)


def profile_intervals(ridge: Ridge, names: Iterable[str]) -> dict[str, tuple[float, float]]:
    """95 % intervals of those of `names` that have a profile of the likelihood."""
    profiled: dict[str, ProfiledParameter] = {name: name for name in AXES}
    return {name: ridge.interval_95(profiled[name]) for name in names if name in profiled}


def normal_interval(value: float, standard_error: float) -> tuple[float, float]:
    """The 95 % interval of a normal estimate."""
    return value - Z_95 * standard_error, value + Z_95 * standard_error


def weak_words(
    name: str,
    parameters: ChannelParameters,
    standard_errors: Mapping[str, float],
    intervals: Intervals,
) -> str:
    """Say that a parameter is hardly determined, and what is known of it."""
    called, unit = WORDS[name]
    if name in intervals:
        known = interval_words(*intervals[name], unit)
    else:
        value, error = getattr(parameters, name), standard_errors[name]
        known = f"{value:.3g} with standard error {error:.2g} {unit}".rstrip()
    return f"the {called} is hardly determined: {known}"


def bounded_words(names: Iterable[str], intervals: Intervals) -> tuple[str, ...]:
    """Say what is known of parameters that are not determined."""
    return tuple(
        f"the {WORDS[name][0]}: {interval_words(*intervals[name], WORDS[name][1])}"
        for name in names
        if name in intervals
    )


def mode_words(parameters: ChannelParameters, below: float) -> str:
    """Say that other parameters are nearly as likely; their log likelihood is `below` less."""
    return (
        f"another set of parameters is nearly as likely (log likelihood {below:.2f} lower): "
        f"K_PL {parameters.k_pl_db:.1f} dBm, n_PL {parameters.n_pl:.2f}, shadowing "
        f"{parameters.shadow_std_db:.2f} dB over {parameters.decorrelation_m:.3g} m, multipath "
        f"{parameters.multipath_std_db:.2f} dB"
    )
