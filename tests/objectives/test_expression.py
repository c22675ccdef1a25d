"""Expressions of one's own: NumPy and CasADi agree, and what is none is refused."""

import casadi as ca
import numpy as np
import pytest

from planopt.errors import InputError
from planopt.objectives.expression import NUMPY, WIDTHS, expression_values, names_in, run_program
from planopt.objectives.expression_casadi import CASADI, PathSymbols, program_of

STEPS = 3


def given(count=4, seed=0):
    """Numbers of all names."""
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
    """The same by CasADi's own evaluation."""
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


@pytest.mark.parametrize("name", sorted(NUMPY))
def test_every_operation_is_the_same_in_both(name):
    """On numbers that most are defined for, 0 among those of logic."""
    reads, apply = NUMPY[name]
    numbers = [(0.3, 0.7), (0.7, 0.3), (0.5, 0.5)] + [(0.0, 1.0)] * (name in ("not", "and", "or"))
    for each in numbers:
        found = CASADI[name][1](*(ca.SX(x) for x in each[:reads]))
        assert CASADI[name][0] == reads
        assert float(ca.evalf(found)) == pytest.approx(float(apply(*each[:reads])), rel=1e-14)


def test_a_constant_is_as_long_as_the_batch():
    """Of a batch of paths."""
    program = program_of(lambda _path: ca.SX(2.5), STEPS)
    np.testing.assert_array_equal(expression_values(program, STEPS, given(5)), np.full(5, 2.5))


def test_no_value_is_said_without_a_warning():
    """A logarithm of what is negative."""
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
    """With an error of ours."""
    with pytest.raises(InputError, match="expression"):
        program_of(expression, STEPS)


@pytest.mark.parametrize(
    "program",
    [
        "",
        "const 0 1.0",
        "output 0",
        "const 0 one\noutput 0",
        "input 0 mean_db 3 0\noutput 0",
        "input 0 mean_db 0 1\noutput 0",
        "input 0 start_m 1 0\noutput 0",
        "input 0 secret 0 0\noutput 0",
        "import os",
        "const 0 1\nadd 1 0\noutput 1",
        "const 0 1\n__import__ 1 0\noutput 1",
    ],
)
def test_what_is_no_program_is_refused(program):
    """Each of them, by the line that is wrong."""
    with pytest.raises(InputError, match=r"instruction|no output"):
        expression_values(program, STEPS, given())
    with pytest.raises(InputError, match=r"instruction|no output"):
        run_program(program, STEPS, {}, CASADI)
