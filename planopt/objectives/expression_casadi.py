# pyright: basic
"""CasADi expressions as instructions, and exact derivatives of these.

Symbols are those of :data:`planopt.objectives.expression.WIDTHS`. Derivatives by them are CasADi's;
what they change with the place comes from the stages' own predictions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.objectives.expression import START, WIDTHS, run_program
from planopt.objectives.stage_chain import chained
from planopt.parts import calling
from planopt.targets.rounding import Derivatives

CASADI: dict[str, tuple[int, Callable[..., Any]]] = {
    "assign": (1, lambda a: a),
    "add": (2, lambda a, b: a + b),
    "sub": (2, lambda a, b: a - b),
    "mul": (2, lambda a, b: a * b),
    "div": (2, lambda a, b: a / b),
    "neg": (1, lambda a: -a),
    "inv": (1, lambda a: 1.0 / a),
    "sq": (1, lambda a: a * a),
    "twice": (1, lambda a: 2.0 * a),
    "pow": (2, lambda a, b: ca.power(a, b)),
    "hypot": (2, lambda a, b: ca.sqrt(a * a + b * b)),
    "lt": (2, lambda a, b: ca.SX(a) < b),
    "le": (2, lambda a, b: ca.SX(a) <= b),
    "eq": (2, lambda a, b: ca.SX(a) == b),
    "ne": (2, lambda a, b: ca.SX(a) != b),
    "not": (1, lambda a: ca.logic_not(a)),
    "and": (2, lambda a, b: ca.logic_and(a, b)),
    "or": (2, lambda a, b: ca.logic_or(a, b)),
    "if_else_zero": (2, lambda a, b: ca.if_else(a, b, 0.0)),
    **{name: (2, getattr(ca, name)) for name in ("atan2", "fmin", "fmax")},
    **{
        name: (1, getattr(ca, name))
        for name in (
            *("sqrt", "exp", "log", "log1p", "expm1", "sin", "cos", "tan", "asin", "acos"),
            *("atan", "sinh", "cosh", "tanh", "erf", "fabs", "sign", "floor", "ceil"),
        )
    },
}
"""The operations of :data:`planopt.objectives.expression.NUMPY` on CasADi's expressions."""

CODES = {getattr(ca, f"OP_{name.upper()}"): name for name in CASADI} | {ca.OP_CONSTPOW: "pow"}
"""CasADi's numbers of them."""

CHANNELS = (
    ("positions_m", 0),
    ("positions_m", 1),
    ("mean_db", 0),
    ("deviation_db", 0),
    ("connectivity", 0),
)
"""What of a step changes with its place: the columns of derivatives."""


@dataclass(frozen=True)
class PathSymbols:
    """The CasADi symbols that an expression is made of, for N steps."""

    positions_m: Any  # (N, 2) the places after each step
    mean_db: Any  # (N, 1) of the predicted power there, dBm and dB
    deviation_db: Any
    connectivity: Any  # (N, 1) P(power >= threshold)
    # (N, 2) where the target is expected; only in a problem with a term of kind tracking
    target_m: Any
    start_m: Any  # (1, 2) where the robot is


def program_of(expression: Any, steps: int) -> str:
    """The instructions of a CasADi expression of a path of `steps` steps."""
    if not isinstance(steps, int | np.integer) or steps < 1:
        raise InputError(
            f"is {steps!r}", key="horizon", remedy="give the whole number of steps that are planned"
        )
    symbols = {name: ca.SX.sym(name, *shape) for name, shape in _shapes(steps).items()}
    remedy = f"return a scalar of {', '.join(symbols)}"
    try:
        value = _value(expression, symbols, remedy)
        function = ca.Function("value", list(symbols.values()), [ca.densify(ca.SX(value))])
    except (RuntimeError, NotImplementedError, TypeError, ValueError) as error:
        raise InputError(
            f"the expression is not one of CasADi: {str(error).splitlines()[-1]}",
            key="expression",
            remedy=remedy,
        ) from None
    if function.size_out(0) != (1, 1):
        raise InputError(
            f"the expression has the shape {function.size_out(0)}, not that of a number",
            key="expression",
            remedy=remedy,
        )
    return "\n".join(_lines(function, list(symbols), steps))


def expression_derivatives(
    program: str, steps: int, given: dict[str, Derivatives], known: dict[str, NDArray[np.float64]]
) -> Any:
    """Value of a path with derivatives by its places."""
    function = _differentiated(program, steps)
    nothing = Derivatives(np.zeros(steps), np.zeros((steps, 2)), np.zeros((steps, 3)))
    inputs = [
        given.get({0: "x", 1: "y"}[column] if name == "positions_m" else name, nothing)
        for name, column in CHANNELS
    ]
    z = np.stack([each.value for each in inputs], axis=1)
    target = known.get("target_m", np.zeros((steps, 2)))
    value, gradient, hessian = function(z.ravel(), target, known[START])
    count = len(CHANNELS)
    return chained(
        float(value),
        np.asarray(gradient).reshape(steps, count),
        np.asarray(hessian.full()).reshape(steps, count, steps, count),
        inputs,
    )


@cache
def _differentiated(program: str, steps: int) -> Any:
    """Value, gradient and Hessian by the numbers of all steps, step after step."""
    count = len(CHANNELS)
    z = ca.SX.sym("z", steps * count)
    fixed = {name: ca.SX.sym(name, *_shapes(steps)[name]) for name in ("target_m", START)}

    def changing(name: str) -> Callable[[int, int], Any]:
        return lambda step, column: z[count * step + CHANNELS.index((name, column))]

    def constant(name: str) -> Callable[[int, int], Any]:
        return lambda step, column: fixed[name][step, column]

    numbers = {name: changing(name) for name in {name for name, _ in CHANNELS}}
    numbers |= {name: constant(name) for name in fixed}
    value = ca.SX(run_program(program, steps, numbers, CASADI))
    hessian, gradient = ca.hessian(value, z)
    return ca.Function("value", [z, *fixed.values()], [value, gradient, hessian])


def _shapes(steps: int) -> dict[str, tuple[int, int]]:
    return {name: (steps, width) for name, width in WIDTHS.items()} | {START: (1, 2)}


def _value(expression: Any, symbols: dict[str, Any], remedy: str) -> Any:
    if not isinstance(expression, ca.Function):
        if not callable(expression):
            raise InputError(
                f"is a {type(expression).__name__}, nothing that can be called",
                key="expression",
                remedy=f"give a function of path, for instance lambda path: ...; {remedy}",
            )
        with calling(expression, "", remedy=remedy):
            return expression(PathSymbols(**symbols))
    names = expression.name_in()
    unknown = [name for name in names if name not in symbols]
    if unknown or expression.n_out() != 1:
        raise InputError(
            f"has the inputs {names} and {expression.n_out()} outputs",
            key="expression",
            remedy=f"name inputs as in {', '.join(symbols)}, and give one output",
        )
    return expression.expand()(*(symbols[name] for name in names))


def _lines(function: Any, names: list[str], steps: int) -> list[str]:
    """One line for each instruction of an SX function."""
    lines: list[str] = []
    for k in range(function.n_instructions()):
        code, reads, writes = (
            ask(k)
            for ask in (
                function.instruction_id,
                function.instruction_input,
                function.instruction_output,
            )
        )
        if code == ca.OP_INPUT:
            name = names[reads[0]]
            rows = _shapes(steps)[name][0]
            lines.append(f"input {writes[0]} {name} {reads[1] % rows} {reads[1] // rows}")
        elif code == ca.OP_CONST:
            lines.append(f"const {writes[0]} {function.instruction_constant(k)!r}")
        elif code == ca.OP_OUTPUT:
            lines.append(f"output {reads[0]}")
        elif code in CODES:
            lines.append(" ".join([CODES[code], *map(str, [*writes, *reads])]))
        else:
            raise InputError(
                f"operation {code} of the expression cannot be saved",
                key="expression",
                remedy=f"use {', '.join(CASADI)}",
            )
    return lines
