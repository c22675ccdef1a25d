"""planopt: motion plans for robots that must stay in radio contact.

Names are imported when they are first used, so that ``import planopt`` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from planopt.channel.fit import fit_channel
    from planopt.channel.measurements import Measurements
    from planopt.channel.parameters import Station
    from planopt.channel.posterior import ChannelPosterior
    from planopt.errors import InputError, NoPlanError, OutputError, PlanoptError
    from planopt.planning.check import check
    from planopt.planning.closed_loop import simulate
    from planopt.planning.plan import Termination, Verdict
    from planopt.planning.solve import solve
    from planopt.problems.library import list_problems
    from planopt.problems.load import load
    from planopt.problems.problem import Problem
    from planopt.studies.compare import compare_horizons

__all__ = [
    "ChannelPosterior",
    "InputError",
    "Measurements",
    "NoPlanError",
    "OutputError",
    "PlanoptError",
    "Problem",
    "Station",
    "Termination",
    "Verdict",
    "check",
    "compare_horizons",
    "fit_channel",
    "list_problems",
    "load",
    "simulate",
    "solve",
]

_MODULES = {
    "ChannelPosterior": "planopt.channel.posterior",
    "InputError": "planopt.errors",
    "Measurements": "planopt.channel.measurements",
    "NoPlanError": "planopt.errors",
    "OutputError": "planopt.errors",
    "PlanoptError": "planopt.errors",
    "Problem": "planopt.problems.problem",
    "Station": "planopt.channel.parameters",
    "Termination": "planopt.planning.plan",
    "Verdict": "planopt.planning.plan",
    "check": "planopt.planning.check",
    "compare_horizons": "planopt.studies.compare",
    "fit_channel": "planopt.channel.fit",
    "list_problems": "planopt.problems.library",
    "load": "planopt.problems.load",
    "simulate": "planopt.planning.closed_loop",
    "solve": "planopt.planning.solve",
}
"""Where each public name stands."""


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """The public names, for completion."""
    return sorted({*globals(), *__all__})
