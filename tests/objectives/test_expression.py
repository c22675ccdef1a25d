"""User-defined expressions: text and CasADi expression agree; other text is refused."""

import casadi as ca
import numpy as np
import pytest
from refusals import refused
from scipy.special import erf

from planopt.objectives.terms.expression import (
    LONGEST_LINE,
    MOST_LINES,
    WIDTHS,
    PathSymbols,
    expression_values,
    names_in,
    program_of,
)

STEPS = 3


def given(count=4, seed=0):
    rng = np.random.default_rng(seed)
    each = {name: rng.normal(size=(count, STEPS, width)) for name, width in WIDTHS.items()}
    return each | {"start_m": rng.normal(size=(count, 1, 2))}


def branching(path):
    """Reads everything, branches, and has the less common operations."""
    near = ca.if_else(path.mean_db[0] < -0.5, path.connectivity[1] ** 3, ca.fmin(2.0, path.mean_db))
    turn = ca.atan2(path.positions_m[0, 1] - path.start_m[1], path.positions_m[0, 0])
    drawn = ca.tanh(path.deviation_db) + ca.erf(path.deviation_db) * ca.fabs(path.mean_db)
    return ca.sum1(near) + turn + ca.sumsqr(drawn) + ca.norm_2(path.target_m[2, :])


def by_casadi(expression, values):
    symbols = {name: ca.SX.sym(name, *each.shape[1:]) for name, each in values.items()}
    function = ca.Function("f", list(symbols.values()), [expression(PathSymbols(**symbols))])
    return [float(function(*row)) for row in zip(*values.values(), strict=True)]


def test_instructions_are_the_expression():
    """Every path of a batch, as CasADi has it."""
    values, program = given(), program_of(branching, STEPS)
    found = expression_values(program, STEPS, values)
    np.testing.assert_allclose(found, by_casadi(branching, values), rtol=1e-13)
    assert names_in(program) == {*WIDTHS, "start_m"}


def test_a_function_with_named_inputs_is_an_expression():
    """Whatever the order of its inputs; an MX function is expanded."""
    chance, power = ca.MX.sym("c", STEPS), ca.MX.sym("m", STEPS)
    function = ca.Function(
        "f", [power, chance], [ca.dot(power, chance)], ["mean_db", "connectivity"], ["value"]
    )
    values = given()
    found = expression_values(program_of(function, STEPS), STEPS, values)
    expected = (values["mean_db"] * values["connectivity"]).sum(axis=(1, 2))
    np.testing.assert_allclose(found, expected)


OPERATIONS = {
    **{name: getattr(np, name) for name in ("sqrt", "exp", "log", "log1p", "expm1", "sin", "cos")},
    **{name: getattr(np, name) for name in ("tan", "sinh", "cosh", "tanh", "fabs", "sign")},
    **{name: getattr(np, name) for name in ("floor", "ceil", "fmin", "fmax", "hypot")},
    **{"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2, "erf": erf},
    **{f"logic_{name}": getattr(np, f"logical_{name}") for name in ("and", "or", "not")},
    "power": np.power,
}
BY_HAND = {
    "-a": lambda a, _b: -a,
    "1.0 / a": lambda a, _b: 1.0 / a,
    "2 * a - b": lambda a, b: 2 * a - b,
    "a < b": np.less,
    "a <= b": np.less_equal,
    "a == b": np.equal,
    "a != b": np.not_equal,
    "if_else(a < b, a, 1e999)": lambda a, b: np.where(a < b, a, np.inf),
    "a ** 2 ** 3": lambda a, _b: a**8,
}


@pytest.mark.parametrize("name", sorted(OPERATIONS))
def test_every_function_is_numpys(name):
    """On positive numbers below 1, for which all of them are defined."""
    oracle, operands = OPERATIONS[name], {"a": 0.3, "b": 0.7}
    count = oracle.nin
    values = given() | {"mean_db": np.tile([[0.3], [0.7], [0.0]], (4, 1, 1))}
    program = program_of(
        lambda path: getattr(ca, name)(*(path.mean_db[k] for k in range(count))), STEPS
    )
    expected = float(oracle(*list(operands.values())[:count]))
    np.testing.assert_allclose(expression_values(program, STEPS, values), expected, rtol=1e-14)


@pytest.mark.parametrize("text", sorted(BY_HAND))
def test_text_by_hand_means_what_python_means(text):
    program = f"a = mean_db[0, 0]\nb = connectivity[2, 0]\n{text}"
    values = given()
    expected = BY_HAND[text](values["mean_db"][:, 0, 0], values["connectivity"][:, 2, 0])
    np.testing.assert_allclose(expression_values(program, STEPS, values), expected, rtol=1e-14)


def test_a_constant_is_as_long_as_the_batch():
    program = program_of(lambda _path: ca.SX(2.5), STEPS)
    np.testing.assert_array_equal(expression_values(program, STEPS, given(5)), np.full(5, 2.5))


def test_no_value_is_said_without_a_warning():
    program = program_of(lambda path: ca.log(-(path.mean_db[0] ** 2)), STEPS)
    assert np.isnan(expression_values(program, STEPS, given())).all()


@pytest.mark.parametrize(
    "expression",
    [
        lambda path: path.mean_db,
        lambda _path: ca.SX.sym("free"),
        lambda path: path.mean_db[7],
        lambda _path: "words",
        ca.Function("f", [ca.SX.sym("z", STEPS)], [ca.SX(1)], ["power"], ["v"]),
        ca.Function("f", [ca.SX.sym("z", 2)], [ca.SX(1)], ["mean_db"], ["v"]),
    ],
)
def test_what_is_no_scalar_of_the_symbols_is_refused(expression):
    with refused():
        program_of(expression, STEPS)


@pytest.mark.parametrize(
    "program",
    [
        "",
        "a = 1.0",
        "a",
        "import os",
        "__import__('os')",
        "().__class__",
        "'words'",
        "1j",
        "True",
        "[1.0][0]",
        "mean_db",
        "mean_db[3, 0]",
        "mean_db[-1, 0]",
        "mean_db[0, 1]",
        "mean_db[0:1, 0]",
        "mean_db[0.0, 0]",
        "start_m[1, 0]",
        "secret[0, 0]",
        "mean_db = 1.0\n2.0",
        "a = b = 1.0\na",
        "a, b = 1.0, 2.0\na",
        "a = 1.0; a",
        "1.0\n2.0",
        "sqrt(1.0, 2.0)",
        "sqrt(x=1.0)",
        "sqrt(*start_m)",
        "print(1.0)",
        "1 < 2 < 3",
        "1 if 2 else 3",
        "1.0 % 2.0",
        "1 << 99999999",
        "lambda: 1.0",
        "(a := 1.0)",
        "(" * 190,
        "-" * 199 + "é",
        "1.0 + " * LONGEST_LINE + "1.0",
        "a = 1.0\n" * (MOST_LINES // STEPS) + "a",
        "a = 1.0 \\\n+ 2.0\na",
    ],
)
def test_other_text_is_refused(program):
    """Each of them, by the line that is wrong."""
    with refused():
        expression_values(program, STEPS, given())


@pytest.mark.parametrize("line", ["9.0 ** 9 ** 9 ** 9 ** 9", "1e999 - 1e999", "-" * 190 + "1.0"])
def test_extreme_numbers_cost_nothing(line):
    """Powers are floating-point numbers, and the nesting of a line is bounded."""
    assert expression_values(line, STEPS, given()).shape == (4,)


def test_repeated_squares_cost_no_more_than_their_lines():
    """A name is one node of the expression however often it is used."""
    program = "a = mean_db[0, 0]\n" + "a = a * a\n" * 5_000 + "a"
    values = given() | {"mean_db": np.ones((4, STEPS, 1))}
    np.testing.assert_array_equal(expression_values(program, STEPS, values), 1.0)
