"""Terms defined by a CasADi expression of the path: ``casadi`` and user-defined kinds."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.channel.prediction import connection_probability
from planopt.errors import InputError
from planopt.objectives.expression import (
    START,
    WIDTHS,
    PathSymbols,
    expression_derivatives,
    expression_values,
    names_in,
    program_of,
)
from planopt.objectives.path_derivatives import PathDerivatives
from planopt.objectives.stage_power import connectivity_derivatives
from planopt.objectives.terms.context import NearPath, Paths, TermContext
from planopt.objectives.terms.term import Term, TermSetting
from planopt.plain_values import make_plain
from planopt.targets.rounding import Derivatives


@dataclass(frozen=True)
class CasadiTerm(Term):
    """User-defined value of a path, created by :func:`planopt.extend.casadi_term`."""

    weight: Annotated[
        float,
        Field(
            default=1.0, ge=-1e9, le=1e9, description="In the sum of terms; negative for a cost."
        ),
    ] = field(default=1.0, kw_only=True)
    steps: Annotated[int, Field(ge=1, description="The horizon that the expression is for.")]
    program: Annotated[
        str, Field(description="Assignments, one a line; the last line is the value.")
    ]

    kind: ClassVar[str] = "casadi"
    summary: ClassVar[str] = "A value of one's own, made large."

    def check(self, setting: TermSetting) -> None:
        """Require a program for the planned horizon whose inputs the problem provides."""
        for name in ("mean_db", "deviation_db"):
            if setting.stations > 1 and name in names_in(self.program):
                raise InputError(
                    f"reads {name}, which is of one station's power, and there are "
                    f"{setting.stations} stations",
                    key="program",
                    remedy="read connectivity, which is to any of them, or leave one entry of "
                    "stations",
                )
        steps = setting.horizon
        if self.steps != steps:
            raise InputError(
                f"is {self.steps}, and planner.horizon is {steps}",
                key="steps",
                remedy="write the term by planopt.extend.casadi_term for this horizon",
            )
        nothing = {name: np.zeros((1, steps, width)) for name, width in WIDTHS.items()}
        expression_values(self.program, steps, nothing | {START: np.zeros((1, 1, 2))})
        if "target_m" in names_in(self.program) and not setting.has_target:
            raise InputError(
                "reads target_m, and there is no target",
                key="program",
                remedy="add an entry of targets and a term of kind tracking, of weight 0 if need "
                "be",
            )

    def known(self, at: TermContext, steps: int) -> dict[str, NDArray[np.float64]]:
        """Return the inputs that do not depend on the path: start, and target if any."""
        if self.steps != steps:
            raise InputError(
                f"an expression is for {self.steps} steps, the plan has {steps}",
                key="objective.terms",
                remedy=f"build it again by planopt.extend.casadi_term, with horizon {steps}",
            )
        known = {START: at.position_m[None]}
        if at.target_m is not None:
            known["target_m"] = at.target_m
        return known

    def value(self, at: TermContext, path_m: NDArray[np.float64]) -> float:
        """Return the value of the expression for one path."""
        power = at.power(path_m)
        chance = connection_probability(power.mean_db, power.deviation_db, at.thresholds_dbm[0])
        inputs = self.known(at, len(path_m)) | {
            "positions_m": path_m,
            "mean_db": power.mean_db[:, None],
            "deviation_db": power.deviation_db[:, None],
            "connectivity": chance[:, None],
        }
        each = {name: values[None] for name, values in inputs.items()}
        value = float(expression_values(self.program, self.steps, each)[0])
        if not np.isfinite(value):
            raise InputError(
                f"is {value:g} for a path that may be driven",
                key="program",
                remedy="keep logarithms and quotients away from 0, for every path",
            )
        return value

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return the values for many paths; non-finite values become -inf."""
        count, steps = paths.shape
        inputs = {"positions_m": paths.paths_m} | {
            name: np.broadcast_to(values, (count, *values.shape))
            for name, values in self.known(paths.at, steps).items()
        }
        for name, values in (
            ("mean_db", paths.power.mean_db),
            ("deviation_db", paths.power.deviation_db),
            ("connectivity", paths.chance),
        ):
            inputs[name] = values.reshape(count, steps, 1)
        found = expression_values(self.program, self.steps, inputs)
        return np.where(np.isfinite(found), found, -np.inf)

    def derivatives(self, path: NearPath) -> PathDerivatives:
        """Return the value with derivatives from CasADi and the chain rule."""
        places, power = path.places_m, path.stage_power
        straight = np.zeros((len(places), 3))
        own = {
            name: Derivatives(
                places[:, axis], np.broadcast_to(np.eye(2)[axis], places.shape), straight
            )
            for axis, name in enumerate(("x", "y"))
        }
        chance = connectivity_derivatives(*power, path.at.thresholds_dbm[0])
        channels = own | {"mean_db": power[0], "deviation_db": power[1], "connectivity": chance}
        return expression_derivatives(
            self.program, self.steps, channels, self.known(path.at, len(places))
        )


def casadi_term(expression: Any, horizon: int, weight: float = 1.0) -> CasadiTerm:
    """Return a term that maximises an expression of the path and the predicted channel.

    The expression is stored as text. Problems, plans and runs that use it are therefore saved,
    checked and sent to other processes like any other.

    Parameters
    ----------
    expression
        Function from :class:`planopt.objectives.expression.PathSymbols` (``positions_m``,
        ``mean_db``, ``deviation_db``, ``connectivity``, ``target_m``, ``start_m``) to a scalar
        CasADi expression, twice differentiable; or a `casadi.Function` with inputs of these names
        and shapes and one output.
    horizon
        Number of steps N of the path.
    weight
        Factor in the sum of terms; negative for a cost.

    Raises
    ------
    InputError
        The expression is not a scalar function of these symbols.
    """
    return CasadiTerm(horizon, program_of(expression, horizon), weight=weight)


@dataclass(frozen=True)
class OwnTerm(Term):
    """Base class of user-defined terms: frozen dataclasses with a ``kind`` and an expression.

    The fields of a subclass are the keys of its table in a problem file. Batch values and
    derivatives are computed from the expression.

    Attributes
    ----------
    weight
        Factor of the term in the sum.
    """

    def __post_init__(self) -> None:
        """Convert lists and arrays to tuples, so that terms can be compared."""
        make_plain(self)

    def expression(self, path: PathSymbols) -> Any:
        """Return the value to be maximised as a scalar CasADi expression of `path`."""
        raise self._without("expression")

    def check(self, setting: TermSetting) -> None:
        """Raise an error if the problem does not support the expression."""
        _written(self, setting.horizon).check(setting)

    def value(self, at: TermContext, path_m: NDArray[np.float64]) -> float:
        """Return the value of the expression for one path."""
        return _written(self, len(path_m)).value(at, path_m)

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return the values of the expression for many paths."""
        return _written(self, paths.shape[1]).values(paths)

    def derivatives(self, path: NearPath) -> PathDerivatives:
        """Return the value with derivatives from CasADi."""
        return _written(self, len(path.places_m)).derivatives(path)


@lru_cache(maxsize=64)
def _written(term: OwnTerm, steps: int) -> CasadiTerm:
    return CasadiTerm(steps, program_of(term.expression, steps))
