# pyright: basic
"""Terms defined by a CasADi expression of the path: ``casadi`` and user-defined kinds.

The text of an expression has one Python assignment per line, such as ``v0 = mean_db[2, 0]``; the
last line is the value. Only arithmetic, comparisons and the functions of `FUNCTIONS` are accepted,
so that the objective of an untrusted file can be evaluated safely.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np
from pydantic import Field

from planopt.arrays import Derivatives, Floats
from planopt.channel.kriging import connection_probability
from planopt.errors import InputError
from planopt.objectives.path_derivatives import PathDerivatives, by_stages
from planopt.objectives.stage_power import connectivity_derivatives
from planopt.objectives.terms.term import NearPath, Paths, Term, TermContext, TermSetting
from planopt.parts import calling, make_plain

WIDTHS = {"positions_m": 2, "mean_db": 1, "deviation_db": 1, "connectivity": 1, "target_m": 2}
"""Number of columns of each input that has one row per step."""
START = "start_m"  # Name of the input (1, 2) with the robot's position
LONGEST_LINE = 200  # Maximum number of characters in a line of a program; it bounds the nesting
MOST_LINES = 100_000  # Maximum of program lines times steps, which limits the cost of derivatives
CHANNELS: tuple[str, ...] = ("positions_m", "mean_db", "deviation_db", "connectivity")
"""Inputs that depend on the position at a step."""

OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}

FUNCTIONS: dict[str, tuple[int, Callable[..., Any]]] = {
    **{name: (2, getattr(ca, name)) for name in ("atan2", "fmin", "fmax", "hypot")},
    **{f"logic_{name}": (2, getattr(ca, f"logic_{name}")) for name in ("and", "or")},
    "logic_not": (1, ca.logic_not),
    "if_else": (3, ca.if_else),
    **{
        name: (1, getattr(ca, name))
        for name in (
            *("sqrt", "exp", "log", "log1p", "expm1", "sin", "cos", "tan", "asin", "acos"),
            *("atan", "sinh", "cosh", "tanh", "erf", "fabs", "sign", "floor", "ceil"),
        )
    },
}
"""Allowed functions by name, with their number of arguments."""

TEXTS = {
    **{ca.OP_ADD: "{} + {}", ca.OP_SUB: "{} - {}", ca.OP_MUL: "{} * {}", ca.OP_DIV: "{} / {}"},
    **{ca.OP_POW: "{} ** {}", ca.OP_CONSTPOW: "{} ** {}", ca.OP_SQ: "{0} * {0}"},
    **{ca.OP_ASSIGN: "{}", ca.OP_NEG: "-{}", ca.OP_INV: "1.0 / {}", ca.OP_TWICE: "2.0 * {}"},
    **{ca.OP_LT: "{} < {}", ca.OP_LE: "{} <= {}", ca.OP_EQ: "{} == {}", ca.OP_NE: "{} != {}"},
    **{ca.OP_AND: "logic_and({}, {})", ca.OP_OR: "logic_or({}, {})", ca.OP_NOT: "logic_not({})"},
    ca.OP_IF_ELSE_ZERO: "if_else({}, {}, 0.0)",
    **{
        getattr(ca, f"OP_{name.upper()}"): f"{name}({', '.join(['{}'] * count)})"
        for name, (count, _) in FUNCTIONS.items()
        if name != "if_else" and not name.startswith("logic")
    },
}
"""Text template of each CasADi instruction in a program."""


@dataclass(frozen=True)
class PathSymbols:
    """CasADi symbols available to an expression of N steps."""

    positions_m: Any  # (N, 2) after each step
    mean_db: Any  # (N, 1) predicted mean power there, dBm
    deviation_db: Any  # (N, 1) predictive standard deviation of the power, dB
    connectivity: Any  # (N, 1) P(power >= threshold)
    target_m: Any  # (N, 2) expected target position; needs a term of kind tracking
    start_m: Any  # (1, 2) position of the robot


def program_of(expression: Any, steps: int) -> str:
    """Return the program text of a CasADi expression for a path of `steps` steps."""
    if not isinstance(steps, int | np.integer) or steps < 1:
        raise InputError(
            f"is {steps!r}, should be a whole number of at least 1",
            key="horizon",
            remedy="give the number of planned steps",
        )
    symbols = {name: ca.SX.sym(name, *shape) for name, shape in _shapes(steps).items()}
    remedy = f"return a scalar computed from {', '.join(symbols)}"
    try:
        value = _value(expression, symbols, remedy)
        function = ca.Function("value", list(symbols.values()), [ca.densify(ca.SX(value))])
    except (RuntimeError, NotImplementedError, TypeError, ValueError) as error:
        raise InputError(
            f"is not a CasADi expression: {str(error).splitlines()[-1]}",
            key="expression",
            remedy=remedy,
        ) from None
    if function.size_out(0) != (1, 1):
        raise InputError(
            f"has the shape {function.size_out(0)}, should be a scalar",
            key="expression",
            remedy=remedy,
        )
    return "\n".join(
        _line(function, k, list(symbols), steps) for k in range(function.n_instructions())
    )


def names_in(program: str) -> frozenset[str]:
    """Return the names of the inputs that `program` reads."""
    return frozenset(name for name in (*WIDTHS, START) if f"{name}[" in program)


def expression_values(program: str, steps: int, inputs: Mapping[str, Floats]) -> Floats:
    """Return the values (c,) of c paths for inputs (c, rows, columns); NaN if undefined."""
    count = max(len(values) for values in inputs.values())
    if not count:
        return np.empty(0)
    buffer, evaluate = _mapped(program, steps, count).buffer()
    # The buffer references the arrays, so they must live until evaluation.
    arrays: list[Floats] = []
    for number, (name, shape) in enumerate(_shapes(steps).items()):
        values = np.broadcast_to(inputs.get(name, np.zeros((1, *shape))), (count, *shape))
        # CasADi matrices are column-major.
        arrays.append(np.ascontiguousarray(values.transpose(0, 2, 1), dtype=np.float64))
        buffer.set_arg(number, memoryview(arrays[-1]))  # pyright: ignore[reportArgumentType]
    found = np.empty(count)
    buffer.set_res(0, memoryview(found))  # pyright: ignore[reportArgumentType]
    evaluate()
    return found


def expression_derivatives(
    program: str, steps: int, inputs: dict[str, Derivatives], known: dict[str, Floats]
) -> PathDerivatives:
    """Return the expression's value for one path, with derivatives w.r.t. its positions."""
    columns = [inputs[name] for name in ("x", "y", *CHANNELS[1:])]
    shapes = _shapes(steps)
    values = dict(zip(CHANNELS[1:], (each.value for each in columns[2:]), strict=True))
    values["positions_m"] = np.stack([each.value for each in columns[:2]], axis=1)
    arrays = [(values | known).get(name, np.zeros(shape)) for name, shape in shapes.items()]
    value, gradient, hessian = _differentiated(program, steps)(*arrays)
    count = len(columns)
    return by_stages(
        float(value),
        np.asarray(gradient).reshape(steps, count),
        np.asarray(hessian.full()).reshape(steps, count, steps, count),
        columns,
    )


@lru_cache(maxsize=64)
def _valued(program: str, steps: int) -> Any:
    """Return the CasADi function that maps the inputs to the value of `program`."""
    symbols = {name: ca.SX.sym(name, *shape) for name, shape in _shapes(steps).items()}
    return ca.Function(
        "value", list(symbols.values()), [ca.densify(_parsed(program, symbols, steps))]
    )


@lru_cache(maxsize=64)
def _mapped(program: str, steps: int, count: int) -> Any:
    """Return the CasADi function that maps the inputs of `count` paths to their values."""
    return _valued(program, steps).map(count)


@lru_cache(maxsize=64)
def _differentiated(program: str, steps: int) -> Any:
    """Return a CasADi function for value, gradient and Hessian w.r.t. the inputs `CHANNELS`."""
    symbols = {name: ca.SX.sym(name, *shape) for name, shape in _shapes(steps).items()}
    value = _parsed(program, symbols, steps)
    # Step-major order: all channels of one step are adjacent.
    channels = ca.vec(ca.horzcat(*(symbols[name] for name in CHANNELS)).T)
    hessian, gradient = ca.hessian(value, channels)
    return ca.Function("derivatives", list(symbols.values()), [value, gradient, hessian])


def _parsed(program: str, symbols: Mapping[str, Any], steps: int) -> Any:
    """Return the CasADi expression of a program."""
    lines = program.splitlines()
    names: dict[str, Any] = {}
    for row, line in enumerate(lines, start=1):
        try:
            if len(lines) * steps > MOST_LINES or len(line) > LONGEST_LINE:
                raise ValueError("there are too many lines for this horizon, or a line is too long")
            match ast.parse(line).body:
                case [ast.Assign([ast.Name(name)], right)] if name not in symbols:
                    names[name] = _built(right, names, symbols)
                case [ast.Expr(right)] if row == len(lines):
                    return _built(right, names, symbols)
                case _:
                    raise ValueError(
                        "should be `name = expression` with a new name; only the last is the value"
                    )
        except (SyntaxError, ValueError, KeyError, TypeError, RecursionError, MemoryError) as error:
            reason = "not an expression, or nested too deeply"
            if type(error) is ValueError:
                reason = str(error)
            elif isinstance(error, KeyError):  # Name, or class of an operation
                name = getattr(error.args[0], "__name__", error.args[0])
                reason = (
                    f"{name} is not a supported operation or function, nor an earlier line or an "
                    "indexed input"
                )
            raise InputError(
                f"is invalid in line {row} of {len(lines)}, {line[:30]!r}: {reason}",
                key="program",
                remedy="create programs with planopt.extend.casadi_term",
            ) from None
    raise InputError("does not compute a value in its last line", key="program")


def _built(node: ast.AST, names: Mapping[str, Any], symbols: Mapping[str, Any]) -> Any:
    """Return the CasADi expression of an allowed node; raise KeyError or ValueError otherwise."""
    match node:
        case ast.Constant(int() | float() as number) if not isinstance(number, bool):
            return ca.SX(float(number))
        case ast.Name(name):
            return names[name]
        case ast.Subscript(
            ast.Name(name), ast.Tuple([ast.Constant(int() as row), ast.Constant(int() as column)])
        ):
            if row >= symbols[name].size1() or column >= symbols[name].size2():
                raise ValueError(f"the shape of {name} is {symbols[name].shape}")
            return symbols[name][row, column]
        case ast.Subscript():
            raise ValueError("an index must be [step, column] of an input, and not negative")
        case ast.UnaryOp(sign, one):
            return OPERATORS[type(sign)](_built(one, names, symbols))
        case ast.BinOp(one, sign, other) | ast.Compare(one, [sign], [other]):
            sides = (_built(each, names, symbols) for each in (one, other))
            return OPERATORS[type(sign)](*sides)
        case ast.Call(ast.Name(name), arguments, []):
            count, apply = FUNCTIONS[name]
            if len(arguments) != count:
                raise ValueError(f"the number of arguments of {name} should be {count}")
            return apply(*(_built(each, names, symbols) for each in arguments))
        case _:
            raise ValueError(f"{type(node).__name__} is not allowed in an expression")


def _shapes(steps: int) -> dict[str, tuple[int, int]]:
    return {name: (steps, width) for name, width in WIDTHS.items()} | {START: (1, 2)}


def _value(expression: Any, symbols: dict[str, Any], remedy: str) -> Any:
    if not isinstance(expression, ca.Function):
        if not callable(expression):
            raise InputError(
                f"is of type {type(expression).__name__}, should be a function",
                key="expression",
                remedy=f"give a function of path, for instance lambda path: ...; {remedy}",
            )
        with calling(expression, "", remedy=remedy):
            return expression(PathSymbols(**symbols))
    names = expression.name_in()
    unknown = [name for name in names if name not in symbols]
    if unknown or expression.n_out() != 1:
        raise InputError(
            f"has the inputs {names} and {expression.n_out()} outputs, which do not fit",
            key="expression",
            remedy=f"name each input as one of {', '.join(symbols)}, and return one output",
        )
    return expression.expand()(*(symbols[name] for name in names))


def _line(function: Any, k: int, names: list[str], steps: int) -> str:
    """Return the line of program text for instruction k of a CasADi SX function."""
    code = function.instruction_id(k)
    reads, writes = function.instruction_input(k), function.instruction_output(k)
    if code == ca.OP_OUTPUT:
        return f"v{reads[0]}"
    if code == ca.OP_INPUT:
        name = names[reads[0]]
        rows = _shapes(steps)[name][0]
        return f"v{writes[0]} = {name}[{reads[1] % rows}, {reads[1] // rows}]"
    if code == ca.OP_CONST:
        # Python has no infinity literal; an overflowing number stands for it.
        return f"v{writes[0]} = {function.instruction_constant(k)!r}".replace("inf", "1e999")
    if code not in TEXTS:
        raise InputError(
            f"has the CasADi operation {code}, which cannot be saved",
            key="expression",
            remedy=f"use + - * / **, comparisons and {', '.join(FUNCTIONS)}",
        )
    return f"v{writes[0]} = {TEXTS[code].format(*(f'v{each}' for each in reads))}"


@dataclass(frozen=True)
class CasadiTerm(Term):
    """User-defined value of a path, created by :func:`planopt.extend.casadi_term`."""

    weight: Annotated[
        float,
        Field(
            default=1.0,
            ge=-1e9,
            le=1e9,
            description="Weight in the sum of terms; negative for a cost.",
        ),
    ] = field(default=1.0, kw_only=True)
    steps: Annotated[int, Field(ge=1, description="The horizon that the expression is for.")]
    program: Annotated[
        str, Field(description="Assignments, one a line; the last line is the value.")
    ]
    # Function that the program was written from, to write it for other horizons
    function: Any = field(default=None, kw_only=True, repr=False, compare=False)

    not_keys: ClassVar[frozenset[str]] = frozenset({"function"})
    kind: ClassVar[str] = "casadi"
    summary: ClassVar[str] = "User-defined expression to maximise."

    @property
    def left_out(self) -> frozenset[str]:
        """Return the fields to omit from a saved table."""
        return self.not_keys

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields without the Python function, which pickle may not support."""
        return {**vars(self), "function": None}

    def at_horizon(self, steps: int) -> CasadiTerm:
        """Return the term with a program for another horizon, if its function is known."""
        if self.function is None or steps == self.steps:
            return self
        return replace(self, steps=steps, program=program_of(self.function, steps))

    def check(self, setting: TermSetting) -> None:
        """Raise an InputError if horizon or inputs of the program do not match the problem."""
        for name in ("mean_db", "deviation_db"):
            if setting.stations > 1 and name in names_in(self.program):
                raise InputError(
                    f"reads {name}, the power of a single station, but the problem has "
                    f"{setting.stations} stations",
                    key="program",
                    remedy="read connectivity, the probability of connection to any station, or "
                    "keep only one entry of stations",
                )
        steps = setting.horizon
        if self.steps != steps:
            raise InputError(
                f"is {self.steps}, but planner.horizon is {steps}",
                key="steps",
                remedy="create the term for this horizon with planopt.extend.casadi_term, or "
                "derive a class from planopt.extend.OwnTerm",
            )
        nothing = {name: np.zeros((1, steps, width)) for name, width in WIDTHS.items()}
        expression_values(self.program, steps, nothing | {START: np.zeros((1, 1, 2))})
        if "target_m" in names_in(self.program) and not setting.has_target:
            raise InputError(
                "reads target_m, but the problem has no target",
                key="program",
                remedy="add an entry of targets and a term of kind tracking (its weight may be 0)",
            )

    def known(self, at: TermContext, steps: int) -> dict[str, Floats]:
        """Return the expression's inputs that do not depend on the path: start and target."""
        if self.steps != steps:
            raise InputError(
                f"contains an expression for {self.steps} steps, but the plan has {steps}",
                key="objective.terms",
                remedy=f"create it again with planopt.extend.casadi_term for horizon {steps}",
            )
        known = {START: at.position_m[None]}
        if at.aim.target_m is not None:
            known["target_m"] = at.aim.target_m
        return known

    def value(self, at: TermContext, path_m: Floats) -> float:
        """Return the value of the expression for one path."""
        power, known = at.predicted(path_m), at.power(path_m)
        chance = connection_probability(known.mean_db, known.deviation_db, at.law.thresholds_dbm[0])
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
                f"is {value:g} for a feasible path",
                key="program",
                remedy="avoid logarithms of 0 and division by 0 for every path",
            )
        return value

    def values(self, paths: Paths) -> Floats:
        """Return the expression's values for many paths; -inf replaces non-finite values."""
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
        """Return the expression's value with derivatives by CasADi and the chain rule."""
        places, power = path.places_m, path.stage_power
        straight = np.zeros((len(places), 3))
        own = {
            name: Derivatives(
                places[:, axis], np.broadcast_to(np.eye(2)[axis], places.shape), straight
            )
            for axis, name in enumerate(("x", "y"))
        }
        chance = connectivity_derivatives(*power, path.at.law.thresholds_dbm[0])
        channels = own | {"mean_db": power[0], "deviation_db": power[1], "connectivity": chance}
        return expression_derivatives(
            self.program, self.steps, channels, self.known(path.at, len(places))
        )


def casadi_term(expression: Any, horizon: int, weight: float = 1.0) -> CasadiTerm:
    """Return a term that maximises an expression of the path and the predicted channel.

    The expression is stored as text. Problems, plans and runs that use it are therefore saved,
    checked and sent to other processes like any other. If the horizon is overridden, for instance
    by :func:`planopt.compare`, the text is generated again from a function; a problem from a file
    keeps its horizon.

    Parameters
    ----------
    expression
        Function from :class:`planopt.objectives.terms.expression.PathSymbols` (``positions_m``,
        ``mean_db``, ``deviation_db``, ``connectivity``, ``target_m``, ``start_m``) to a scalar
        CasADi expression, twice differentiable; or a `casadi.Function` with inputs of these names
        and shapes and one output.
    horizon
        Number of steps N of the problem's plans.
    weight
        Factor in the sum of terms; negative for a cost.

    Raises
    ------
    InputError
        The expression is not a scalar function of these symbols.
    """
    function = None if isinstance(expression, ca.Function) else expression
    return CasadiTerm(horizon, program_of(expression, horizon), weight=weight, function=function)


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

    def value(self, at: TermContext, path_m: Floats) -> float:
        """Return the value of the expression for one path."""
        return _written(self, len(path_m)).value(at, path_m)

    def values(self, paths: Paths) -> Floats:
        """Return the values of the expression for many paths."""
        return _written(self, paths.shape[1]).values(paths)

    def derivatives(self, path: NearPath) -> PathDerivatives:
        """Return the expression's value with derivatives by CasADi."""
        return _written(self, len(path.places_m)).derivatives(path)


@lru_cache(maxsize=64)
def _written(term: OwnTerm, steps: int) -> CasadiTerm:
    return CasadiTerm(steps, program_of(term.expression, steps))
