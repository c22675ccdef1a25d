"""A user's own objective as a list of instructions: plain text that files keep, and NumPy runs.

Each line is an operation, the register that it writes, and the registers that it reads::

    input 0 mean_db 2 0        mean_db of the third step
    const 1 -40.0
    sub 2 0 1
    output 2                   the value

Nothing but arithmetic can be said in it, so that a file from elsewhere can be judged safely.
:mod:`planopt.objectives.expression_casadi` writes it from a CasADi expression, and differentiates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf  # pyright: ignore[reportUnknownVariableType]

from planopt.errors import InputError

WIDTHS = {
    "positions_m": 2,
    "mean_db": 1,
    "deviation_db": 1,
    "connectivity": 1,
    "target_m": 2,
}
"""What an expression may read of each of the N steps, and how many numbers that are."""

START = "start_m"
"""The robot's own place, the row 0 of two numbers, may be read besides."""

LONGEST = 200_000
"""Instructions; more would take seconds for each path."""

Operation = Callable[..., Any]


UNARY: dict[str, Callable[[Any], Any]] = {
    "assign": lambda a: a,
    "neg": np.negative,
    "inv": lambda a: 1.0 / a,
    "sq": np.square,
    "twice": lambda a: 2.0 * a,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "log1p": np.log1p,
    "expm1": np.expm1,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "erf": erf,
    "fabs": np.abs,
    "sign": np.sign,
    "floor": np.floor,
    "ceil": np.ceil,
    "not": lambda a: np.where(a == 0.0, 1.0, 0.0),
}

BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "pow": np.power,
    "atan2": np.arctan2,
    "hypot": np.hypot,
    "fmin": np.fmin,
    "fmax": np.fmax,
    "lt": lambda a, b: np.where(a < b, 1.0, 0.0),
    "le": lambda a, b: np.where(a <= b, 1.0, 0.0),
    "eq": lambda a, b: np.where(a == b, 1.0, 0.0),
    "ne": lambda a, b: np.where(a != b, 1.0, 0.0),
    "and": lambda a, b: np.where((a != 0.0) & (b != 0.0), 1.0, 0.0),
    "or": lambda a, b: np.where((a != 0.0) | (b != 0.0), 1.0, 0.0),
    "if_else_zero": lambda a, b: np.where(a != 0.0, b, 0.0),
}

NUMPY: dict[str, tuple[int, Operation]] = {
    **{name: (1, apply) for name, apply in UNARY.items()},
    **{name: (2, apply) for name, apply in BINARY.items()},
}
"""How many registers each operation reads, and what it does."""


def expression_values(
    program: str, steps: int, given: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.float64]:
    """The value of each of c paths; not finite where the expression has none; ``(c,)``."""
    with np.errstate(all="ignore"):
        found = run_program(
            program, steps, {name: _entry(values) for name, values in given.items()}, NUMPY
        )
    count = max(len(values) for values in given.values())
    return np.broadcast_to(np.asarray(found, dtype=np.float64), (count,)).copy()


def names_in(program: str) -> frozenset[str]:
    """Return the names that the instructions read."""
    lines = (line.split() for line in program.splitlines())
    return frozenset(words[2] for words in lines if len(words) == 5 and words[0] == "input")


def run_program(
    program: str,
    steps: int,
    given: Mapping[str, Callable[[int, int], Any]],
    operations: Mapping[str, tuple[int, Operation]],
) -> Any:
    """Run the instructions, by NumPy's operations or CasADi's, on entries by row and column."""
    registers: dict[str, Any] = {}
    value: Any = None
    for row, words in enumerate(_instructions(program), start=1):
        try:
            match words:
                case ("input", to, name, step, column):
                    registers[to] = given[name](*_checked(name, int(step), int(column), steps))
                case ("const", to, number):
                    registers[to] = float(number)
                case ("output", at):
                    value = registers[at]
                case (operation, to, *at):
                    reads, apply = operations[operation]
                    if len(at) != reads:
                        raise ValueError
                    registers[to] = apply(*(registers[each] for each in at))
                case _:
                    raise ValueError
        except (KeyError, ValueError):
            raise InputError(
                f"instruction {row} ({' '.join(words)}) is none of an expression of {steps} steps",
                key="program",
                remedy="write programs by planopt.extend.casadi_term",
            ) from None
    if value is None:
        raise InputError("the program has no output", key="program")
    return value


@cache
def _instructions(program: str) -> tuple[tuple[str, ...], ...]:
    found = tuple(tuple(line.split()) for line in program.splitlines())
    if len(found) > LONGEST:
        raise InputError(f"{len(found)} instructions are too many", key="program")
    return found


def _checked(name: str, step: int, column: int, steps: int) -> tuple[int, int]:
    rows, width = (1, 2) if name == START else (steps, WIDTHS[name])
    if not (0 <= step < rows and 0 <= column < width):
        raise ValueError
    return step, column


def _entry(values: NDArray[np.float64]) -> Callable[[int, int], NDArray[np.float64]]:
    return lambda step, column: values[:, step, column]
