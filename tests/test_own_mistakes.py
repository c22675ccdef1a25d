"""Mistakes in a user's own parts, through every public door: each is an error of planopt's."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import casadi as ca
import numpy as np
import pytest
from refusals import refused
from terms_scene import LEARNING, terms_problem

import planopt
from planopt import Constraints, InputError, Problem, Robot, solve
from planopt.channel import posterior_map
from planopt.extend import (
    CasadiMap,
    Dynamics,
    OwnRule,
    OwnTerm,
    PlannerKind,
    Term,
    casadi_term,
    free_ends,
    register_planner,
    released,
)
from planopt.objectives import LearningTerm
from planopt.objectives.path_derivatives import PathDerivatives
from planopt.problems import FunctionTruth
from planopt.robots.dynamics import rolled_out

pytestmark = pytest.mark.usefixtures("own_parts")


@pytest.fixture(scope="module")
def base() -> Problem:
    return terms_problem(LEARNING, horizon=2)


def own_class(parent: type, **attributes) -> type:
    """A frozen dataclass with the kind ``wrong``, unless another is given."""
    attributes.setdefault("kind", "wrong")
    hints = {"kind": "ClassVar[str]", "x": "float"}
    known = {"__annotations__": {name: hints[name] for name in hints if name in attributes}}
    found = type("Mine", (parent,), {**known, "__module__": __name__, **attributes})
    return dataclass(frozen=True)(found)


def made(base: Problem, **parts) -> Problem:
    """A problem of the small one's parts and these."""
    given = {
        name: getattr(base, name)
        for name in ("robots", "stations", "workspace", "objective", "planner", "channel")
    }
    return Problem(**{**given, **parts})


def expression_of(value) -> type:
    return own_class(OwnTerm, expression=value)


def test_lists_in_a_term_become_tuples() -> None:
    assert own_class(OwnTerm, x=0.0)(x=[1.0, 2.0]).x == (1.0, 2.0)


def tried(value):
    return {"probes_end": True, "probe_values": lambda self, at, ways, chance: value(ways)}


ONES = {"value": lambda self, at, path_m: 1.0, "values": lambda self, at: np.ones(at.shape[0])}


@pytest.mark.parametrize(
    "methods",
    [
        {},
        {"values": lambda self, paths: np.ones(1)},
        {"values": lambda self, paths: paths.nothing},
        {"value": lambda self, at, path_m: None},
        {"value": lambda self, at, path_m: np.nan},
        {"node_reward": lambda self, at: None},
        {"probes_end": True},
        tried(lambda ways: 1 / 0),
        tried(lambda ways: np.ones(3)),
        tried(lambda ways: ways[:, 0, 0] * np.nan),
        tried(lambda ways: None),
    ],
)
def test_wrong_methods_of_a_term(base, methods) -> None:
    """Class and method are named, and what it should return."""
    whole = {**ONES, **methods} if methods else {}
    problem = made(base, objective=own_class(Term, **whole)())
    with refused():
        solve(problem, planner="lattice", seed=0)


def parts_of(value=0.0, gradient=None, hessian=None):
    """Derivatives of two steps, some of them wrong."""
    gradient = np.zeros(4) if gradient is None else gradient
    return PathDerivatives(value, gradient, np.zeros((4, 4)) if hessian is None else hessian)


@pytest.mark.parametrize("planner", ["nlp", "scp"])
@pytest.mark.parametrize(
    "derivatives",
    [
        lambda self, path: path.nothing,
        lambda self, path: None,
        lambda self, path: parts_of(value="much"),
        lambda self, path: parts_of(gradient=np.zeros(3)),
        lambda self, path: parts_of(hessian=np.zeros(4)),
    ],
)
def test_wrong_derivatives(base, capfd, derivatives, planner) -> None:
    """Whatever the solver, one error names the method, and nothing is printed."""
    term = own_class(Term, **ONES, derivatives=derivatives)()
    with refused():
        solve(made(base, objective=term), planner=planner, seed=0)
    assert capfd.readouterr() == ("", "")


class Maker:
    """A planner without the method that plans."""

    def __init__(self, problem, ground, generator) -> None:
        self.problem, self.ground = problem, ground


def planner_of(plan) -> type:
    return type("Planning", (Maker,), {"plan": plan, "__module__": __name__})


@pytest.mark.parametrize(
    "make",
    [
        Maker,
        lambda problem: None,
        planner_of(lambda self, at, scorer, warm=None: None),
        planner_of(lambda self, at, scorer, warm=None: np.zeros((2, 2))),
        planner_of(lambda self, at, scorer: None),
        planner_of(lambda self, at, scorer, warm=None: at.nothing),
        planner_of(lambda self, at, scorer, warm=None: released(scorer, np.zeros((2, 3)), 0.0)),
        planner_of(lambda self, at, scorer, warm=None: released(scorer, None, 0.0)),
        planner_of(lambda self, at, scorer, warm=None: released(np.zeros((2, 2)), scorer, 0.0)),
        planner_of(
            lambda self, at, scorer, warm=None: free_ends(
                self.problem, self.ground, at.position_m, at.position_m
            )
        ),
    ],
)
def test_wrong_planners(base, make) -> None:
    """Class and method are named, and what it should return."""
    register_planner(PlannerKind("wrong", make))
    with refused():
        solve(base, planner="wrong")


def test_a_path_may_be_a_list(base) -> None:
    make = planner_of(lambda self, at, scorer, warm=None: released(scorer, [[10.0, 15.0]] * 2, 0.0))
    register_planner(PlannerKind("listing", make))
    assert solve(base, planner="listing").plan.positions_m.shape == (3, 2)


@pytest.mark.parametrize(
    "methods",
    [
        {"achieved": lambda self, p, history: None},
        {"achieved": lambda self, p, history: p},
        {"achieved": lambda self, p: 1.0},
        {"achieved": lambda self, p, history: history.x},
        {"requirement": lambda self, p_min: "much"},
        {"requirement": lambda self, p_min: self.nowhere},
        {"achieved": lambda self, p, history: p.sum(axis=-1)},
        {"achieved": lambda self, p, history: -p.mean(axis=-1)},
        {"achieved": lambda self, p, history: p.mean(axis=-1) * np.nan},
        {"achieved": lambda self, p, history: 1.0 - p.mean(axis=-1)},
        {"requirement": lambda self, p_min: 1.0 + p_min},
    ],
)
def test_wrong_methods_of_a_rule(base, methods) -> None:
    """Class and method are named, and what it should return."""
    own_class(OwnRule, **{"achieved": lambda self, p, history: p.mean(axis=-1), **methods})
    rule = planopt.ConnectivityRule("wrong")
    problem = replace(base, constraints=replace(base.constraints, p_min=0.5, rule=rule))
    with refused():
        solve(problem, seed=0)


def test_a_rule_may_count_something_else(base) -> None:
    """With a unit of its own, what is achieved may be any number."""
    own_class(
        OwnRule,
        achieved=lambda self, p, history: p.sum(axis=-1),
        requirement=lambda self, p_min: 1.5,
        unit="steps",
        uses_p_min=False,
    )
    rule = planopt.ConnectivityRule("wrong")
    plan = solve(replace(base, constraints=replace(base.constraints, rule=rule)), seed=0).plan
    assert plan.certificate.rule.achieved == pytest.approx(plan.connectivity[1:].sum(), abs=1e-6)


X, U = ca.SX.sym("x", 2), ca.SX.sym("u", 2)
MAP = {
    "function": ca.Function("f", [X, U], [X + U]),
    "state_names": ("x_m", "y_m"),
    "input_names": ("a", "b"),
    "speed_max_m_s": 2.0,
    "state_bounds": ((-9.0, 9.0),) * 2,
    "input_bounds": ((-2.0, 2.0),) * 2,
    "rest_input": (0.0, 0.0),
}


def test_maps_of_lists_and_arrays() -> None:
    """Lists and arrays are as good as tuples."""
    given = CasadiMap(
        **{key: [*value] if isinstance(value, tuple) else value for key, value in MAP.items()}
    )
    assert given.state_names == ("x_m", "y_m")
    arrays = {key: np.array(MAP[key]) for key in ("state_bounds", "input_bounds", "rest_input")}
    assert CasadiMap(**{**MAP, **arrays}).rest_input == (0.0, 0.0)


def test_maps_that_fail_along_the_path(base) -> None:
    """NaN two metres from the start is a fault of the map, not of a term."""
    far = X[0] > base.robots[0].start_m[0] + 0.1
    after = ca.if_else(far, X / 0, X + ca.vertcat(1.0, 0.0) * (0.2 + ca.fabs(U[0])))
    car = CasadiMap(**{**MAP, "function": ca.Function("f", [X, U], [after])})
    state = np.array(base.robots[0].start_m)
    with refused():
        rolled_out(car, state, np.zeros((3, 2)), 1.0)


def belt_map(after, bounds: tuple[float, float], inputs: tuple[float, float]) -> CasadiMap:
    """A map of x, y and the speed v of a belt; `after` gives x and v after a step."""
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 1)
    forward, speed = after(x, u)
    return CasadiMap(
        function=ca.Function("f", [x, u], [ca.vertcat(forward, x[1], speed)]),
        state_names=("x_m", "y_m", "v"),
        input_names=("a",),
        speed_max_m_s=2.0,
        state_bounds=((-999.0, 999.0), (-999.0, 999.0), bounds),
        input_bounds=(inputs,),
        rest_input=(0.0,),
    )


def test_a_map_may_rest_elsewhere(base) -> None:
    """A robot that starts moving, and whose rest needs another component than zero."""
    car = belt_map(
        lambda x, u: (x[0] + x[2] - 0.5, 0.5 * x[2] + 0.25 + u), (-999.0, 999.0), (-2.0, 2.0)
    )
    robot = replace(base.robots[0], dynamics=car, start_rest=(0.8,))
    assert made(base, robots=robot).robots[0].start_rest == (0.8,)
    assert np.abs(car.change_at_rest(robot.start_state, 1.0)).max() < 1e-9


@pytest.mark.parametrize(
    ("speed", "start", "bounds", "change_m"),
    [
        # Its only rest is at a bound: v is +-1.
        (lambda v: ca.sqrt(1.0 - v**2), 1.0, (-1.0, 1.0), 0.0),
        (lambda v: ca.sqrt(1.0 - v**2), 0.3, (-1.0, 1.0), 0.0),
        # At rest for v = 1; not finite for v = 0, within the bounds or at one.
        (ca.log, 0.5, (0.0, 2.0), 0.0),
        (ca.log, 0.5, (-1.0, 2.0), 0.0),
        # Nowhere at rest: slowest at the upper bound.
        (lambda v: 1.0 / v, 1.0, (0.0, 2.0), 0.5),
        (lambda v: 1.0 / v, 1.0, (-0.5, 2.0), 0.5),
        # No bounds to search between.
        (lambda v: 1.0 - v, 1.0, (1.0, 1.0), 0.0),
        (lambda v: 1.0 / v, 1.0, (1.0, 1.0), 1.0),
    ],
)
def test_rest_is_looked_for_where_a_map_is_finite(base, speed, start, bounds, change_m) -> None:
    """Bounds of the state beyond which, or at which, the map is NaN or infinite."""
    car = belt_map(lambda x, u: (x[0] + speed(x[2]), x[2] + u), bounds, (-0.01, 0.0))
    robot = replace(base.robots[0], dynamics=car, start_rest=(start,))
    found = np.abs(car.change_at_rest(robot.start_state, 1.0)).max()
    assert found == pytest.approx(change_m, abs=1e-6)
    if change_m == 0.0:
        assert made(base, robots=robot).robots[0].start_rest == (start,)
        return
    with refused():
        made(base, robots=robot)


class Half:
    """Has some of what dynamics need."""

    kind, state_names, input_names = "half", ("x_m", "y_m"), ("a",)

    def step(self, state, control, step_s):
        return state


def test_faults_of_planopt_stay_what_they_are(monkeypatch, base) -> None:
    """Only a user's own code is a user's fault."""
    monkeypatch.setattr(LearningTerm, "values", lambda self, paths: paths.nothing)
    with pytest.raises(AttributeError):
        solve(base, seed=0)


def test_the_line_is_that_of_the_users_code(base) -> None:
    with pytest.raises(InputError) as caught:
        made(base, objective=expression_of(lambda self, path: path.nowhere)())
    assert caught.value.file == str(Path(__file__))
    assert caught.value.__cause__ is not None


FUNCTION_TRUTH = FunctionTruth(power_dbm=lambda places_m: -50.0 - places_m[:, 0])
DOORS = (
    *(planopt.load, planopt.check, planopt.load_result, planopt.explain, planopt.solve),
    *(planopt.simulate, planopt.Planner),
)


def with_robot(base: Problem, part: dict) -> Problem:
    """The problem with changed attributes of its robot."""
    return made(base, robots=replace(base.robots[0], **part))


def with_part(base: Problem, name: str, **part) -> Problem:
    """The problem with changed attributes of a part."""
    return made(base, **{name: replace(getattr(base, name), **part)})


def with_stations(base: Problem, names: list[str]) -> Problem:
    """The problem with several stations and one ground truth."""
    stations = [replace(base.stations[0], name=name) for name in names]
    return made(base, stations=stations, channel=replace(base.channel, truth=FUNCTION_TRUTH))


def nameless() -> OwnTerm:
    @dataclass(frozen=True)
    class Nameless(OwnTerm):
        pass

    return Nameless()


def plain() -> OwnTerm:
    class Plain(OwnTerm):
        kind: ClassVar[str] = "plain"

        def __init__(self, x) -> None:
            object.__setattr__(self, "x", x)

    return Plain(2.0)


def hinted(hint: str) -> type:
    """A term with a field of this annotation."""
    hints = {"kind": "ClassVar[str]", "x": hint}
    fields = {"kind": "wrong", "x": 1.0, "__annotations__": hints, "__module__": __name__}
    return dataclass(frozen=True)(type("Mine", (OwnTerm,), fields))


def with_truth(base: Problem, function) -> None:
    truth = FunctionTruth(power_dbm=function)
    solve(made(base, channel=replace(base.channel, truth=truth)), seed=0)


def with_map(base: Problem, after) -> Problem:
    car = CasadiMap(**{**MAP, "function": ca.Function("f", [X, U], [after])})
    return with_robot(base, {"dynamics": car})


def rule_named(_, parts: dict) -> planopt.ConnectivityRule:
    own_class(OwnRule, **parts)
    return planopt.ConnectivityRule("wrong")


def mapped(base: Problem, changes: dict) -> None:
    belief = solve(base, planner="lattice", seed=0).belief
    arguments = [belief.posterior, base.workspace.bounds_m, 1.0, -80.0]
    for number, value in changes.items():
        arguments[number] = belief if value == "belief" else value
    posterior_map(*arguments)


KINDS = (3, None, "", "a b", "x" * 101, property(lambda self: "x"))
EXPRESSIONS = (
    lambda self, path: path.speed_m_s,
    lambda self, path: self.missing,
    lambda self, path: None,
    lambda self: 1.0,
    lambda self, path: {}["x"],
    lambda self, path: path.positions_m,
    lambda self, path: 1.0 if path.start_m[0] > 3 else 0.0,
    lambda self, path: 1 / 0,
    lambda self, path: ca.SX.sym("z"),
)
MAPS = (
    {"function": lambda x, u: x},
    {"function": None},
    {"function": ca.Function("f", [X, U, ca.SX.sym("t")], [X])},
    {"function": ca.Function("f", [X, U], [])},
    {"function": ca.Function("f", [X, U], [X.T])},
    {"state_names": "xy"},
    {"input_names": (1, 2)},
    {"state_bounds": (-1, 1)},
    {"state_bounds": ((None, None),) * 2},
    {"input_bounds": ((-1, 0, 1),) * 2},
    {"input_bounds": (("a", "b"),) * 2},
    {"input_bounds": ((1.0, -1.0),) * 2},
    {"rest_input": 0.0},
    {"rest_input": (np.nan, 0.0)},
    {"speed_max_m_s": "fast"},
    {"speed_max_m_s": 0.0},
    {"substeps": 2.5},
)
TRUTHS = (
    lambda places_m: places_m.nothing,
    lambda x, y: x,
    -50.0,
    np.zeros((4, 4)),
    lambda places_m: np.full(len(places_m), 500.0),
    lambda places_m: np.full(len(places_m), -1e9),
    lambda places_m: np.full(len(places_m), -60.0 + 1j),
    lambda places_m: np.full(len(places_m), "-60"),
)

# A function of the problem and a value, and wrong values.
MISTAKES = [
    *(
        (lambda _, v, parent=parent: own_class(parent, kind=v), KINDS)
        for parent in (OwnTerm, OwnRule)
    ),
    (lambda base, v: made(base, objective=v()), (nameless, plain)),
    (lambda base, v: made(base, objective=hinted(v)()), ("np.ndarray", "Nowhere")),
    (lambda base, v: made(base, objective=expression_of(v)()), EXPRESSIONS),
    (lambda _, v: CasadiMap(**{**MAP, **v}), MAPS),
    (with_map, (X + U / 0, X + U * ca.sqrt(U[0]), X + U + 0.5)),
    (with_truth, TRUTHS),
    (rule_named, ({"uses_p_min": False}, {})),
    (mapped, ({0: "belief"}, {1: 3}, {2: "1"}, {3: None}, {2: True})),
    (lambda _, v: casadi_term(v, 2), (3.0, ca.SX.sym("x"))),
    (lambda _, v: casadi_term(v, 2), (lambda path: path.nowhere,)),
    (lambda _, v: casadi_term(lambda path: path.start_m[0], v), ("2", 0)),
    (
        lambda base, v: made(base, objective=v),
        (LearningTerm, [LearningTerm], {"kind": "mapping"}, 3, "mapping"),
    ),
    (lambda _, v: register_planner(v), ("x", PlannerKind)),
    (lambda _, v: register_planner(PlannerKind(v, Maker)), (3, "nlp")),
    (lambda _, v: register_planner(PlannerKind("a", v)), (Maker(1, 2, 3), None)),
    (lambda _, v: PlannerKind("mine", v).maker(), ("nowhere", ":x", "a b:x", "planopt:nothing")),
    (lambda _, v: planopt.ConnectivityRule("each_step", settings=v), ([1, 2], None, "steps", 3)),
    (lambda _, v: Constraints(p_min=0.5, rule=v), ("joint", OwnRule, {"connectivity": "joint"}, 3)),
    (
        lambda _, v: Robot(start_m=(1, 1), speed_max_m_s=1.0, dynamics=v),
        (Half(), type("Heir", (Half, Dynamics), {})()),
    ),
    (
        lambda _, v: Robot(start_m=(1, 1), speed_max_m_s=1.0, dynamics=v),
        (CasadiMap, MAP["function"], lambda x, u: x, {"kind": "unicycle"}),
    ),
    (
        lambda base, v: with_robot(base, {"start_rest": v, "dynamics": CasadiMap(**MAP)}),
        ("ab", 3.0),
    ),
    (with_robot, ({"weights": 2.0},)),
    *((lambda _, v, door=door: door(v), (3, None)) for door in DOORS),
    (lambda base, v: solve(base, seed=0).save(v), (None, 3)),
    (lambda base, v: solve(base, seed=v), ("a", -1, 0.5)),
    (lambda _, v: planopt.Measurements(v, -50.0), (1.0,)),
    (lambda _, v: planopt.Measurements(v, -50.0), ([1.0, 2.0],)),
    (lambda base, v: with_part(base, "planner", horizon=v), (0,)),
    (lambda base, v: with_part(base, "planner", step_s=v), (-1.0,)),
    (lambda base, v: with_part(base, "constraints", p_min=v), (1.5,)),
    (lambda base, v: with_part(base, "constraints", clearance_m=v), (-1.0,)),
    (lambda base, v: replace(base.channel, truth=v), ([FUNCTION_TRUTH] * 2,)),
    (lambda base, v: solve(with_stations(base, v), seed=0), (["one", "other"],)),
    (with_stations, (["one", "one"],)),
]


@pytest.mark.parametrize(
    ("make", "value"), [(make, value) for make, values in MISTAKES for value in values]
)
def test_a_mistake_is_explained(base, make, value) -> None:
    """The key, the value, and what to give."""
    with refused():
        make(base, value)


def test_remedies_of_check(base, tmp_path) -> None:
    """Every error of a damaged file says what to do."""
    solve(base, seed=0).save(tmp_path)
    for name, damage in (
        ("plan.json", lambda text: text.replace('"seed"', '"sed"')),
        ("belief.npz", lambda text: "x"),
    ):
        kept = (tmp_path / name).read_bytes()
        (tmp_path / name).write_text(damage(kept.decode(errors="replace")))
        with refused():
            planopt.check(tmp_path)
        (tmp_path / name).write_bytes(kept)
