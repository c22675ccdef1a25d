"""What a plan says of how it was found, against its path and against itself."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import small_problem

from planopt.planning.certificate import Certificate
from planopt.planning.check.rebuilt import provenance_faults
from planopt.planning.plan import Pivot, Plan, Rung, Termination, Verdict

PROBLEM = small_problem()
NOWHERE = np.zeros(3)
POLISHED = Plan(
    robot="robot",
    t_s=np.arange(3.0),
    positions_m=np.array([[5.0, 15.0], [7.0, 15.0], [9.0, 15.0]]),
    mean_dbm=NOWHERE,
    deviation_db=NOWHERE,
    connectivity=NOWHERE,
    objective=10.0,
    lattice_objective=11.0,
    termination=Termination.CONVERGED,
    verdict=Verdict.VERIFIED,
    rung=Rung.PLAN,
    certificate=Certificate(2.0, 0.9, 0.0, 1e-7, "exact"),
    wall_s=0.1,
    solve_s=0.05,
    iterations=9,
    pivot=Pivot(np.array([12.0, 15.0]), 30.0),
)
MISSING = replace(POLISHED.certificate, relaxed_steps=(1,), relaxation_db=(0.5,))
UNPOLISHED = replace(
    POLISHED,
    lattice_objective=10.0,
    rung=Rung.LATTICE,
    termination=Termination.LATTICE_ONLY,
    certificate=replace(POLISHED.certificate, kkt_residual=None),
    solve_s=0.0,
    iterations=0,
)
STANDING = replace(
    UNPOLISHED,
    rung=Rung.STOP,
    termination=Termination.NO_PATH,
    positions_m=np.tile([5.0, 15.0], (3, 1)),
    pivot=None,
)
SHIFTED = replace(
    UNPOLISHED,
    rung=Rung.SHIFTED,
    termination=Termination.STOPPED,
    positions_m=POLISHED.positions_m[[1, 2, 2]],
    pivot=None,
)


def with_residual(residual: float) -> Plan:
    """The polished plan with another KKT residual."""
    return replace(POLISHED, certificate=replace(POLISHED.certificate, kkt_residual=residual))


def faulty_keys(plan: Plan, previous: Plan | None = None, problem=PROBLEM) -> set[str]:
    """Keys of what cannot be so."""
    return {key for key, _ in provenance_faults(problem, plan, previous)}


@pytest.mark.parametrize(
    "plan",
    [
        POLISHED,
        UNPOLISHED,
        STANDING,
        replace(POLISHED, rung=Rung.COLD_RETRY, termination=Termination.ITERATION_LIMIT),
        replace(with_residual(1e5), termination=Termination.ITERATION_LIMIT),
        replace(POLISHED, rung=Rung.RELAXED, certificate=MISSING),
        replace(UNPOLISHED, termination=Termination.INFEASIBLE, solve_s=0.1, iterations=30),
    ],
)
def test_what_planners_give_is_possible(plan: Plan) -> None:
    """Nothing is said against it."""
    assert faulty_keys(plan) == set()


def test_the_rest_of_a_verified_plan() -> None:
    """Shifted is what comes after the first step of the plan before, which was verified."""
    assert faulty_keys(SHIFTED, POLISHED) == set()
    assert faulty_keys(SHIFTED) == {"rung"}
    assert faulty_keys(SHIFTED, replace(POLISHED, verdict=Verdict.VIOLATED)) == {"rung"}
    moved = replace(SHIFTED, positions_m=SHIFTED.positions_m + 0.01)
    assert faulty_keys(moved, POLISHED) == {"rung"}
    longer = replace(POLISHED, positions_m=np.vstack([POLISHED.positions_m, [[9.0, 16.0]]]))
    assert faulty_keys(SHIFTED, longer) == {"rung"}


@pytest.mark.parametrize(
    ("plan", "keys"),
    [
        (replace(STANDING, positions_m=POLISHED.positions_m), {"rung"}),
        (replace(POLISHED, rung=Rung.RELAXED), {"rung"}),
        (replace(UNPOLISHED, certificate=replace(MISSING, kkt_residual=None)), {"rung"}),
        (replace(UNPOLISHED, termination=Termination.STOPPED), {"termination"}),
        (replace(UNPOLISHED, rung=Rung.PLAN), {"termination"}),
        (replace(UNPOLISHED, solve_s=0.1), {"solve_s"}),
        (replace(UNPOLISHED, iterations=3), {"iterations"}),
        (replace(UNPOLISHED, certificate=POLISHED.certificate), {"kkt_residual"}),
        (
            replace(
                UNPOLISHED, certificate=POLISHED.certificate, termination=Termination.ACCEPTABLE
            ),
            {"kkt_residual"},
        ),
        (with_residual(1e300), {"kkt_residual"}),
        (with_residual(1e5), {"kkt_residual"}),
        (
            replace(with_residual(1e300), termination=Termination.ITERATION_LIMIT),
            {"kkt_residual"},
        ),
        (replace(UNPOLISHED, lattice_objective=10.5), {"lattice_objective"}),
        (replace(POLISHED, pivot=None), {"pivot"}),
    ],
)
def test_what_no_planner_gives(plan: Plan, keys: set[str]) -> None:
    """Each contradiction is found by its key."""
    assert faulty_keys(plan) == keys


def test_the_lattice_planner_polishes_nothing() -> None:
    """Its plans come from the rung `plan`, and no solver stopped for any reason."""
    lattice = small_problem(planner="lattice")
    assert faulty_keys(replace(UNPOLISHED, rung=Rung.PLAN), problem=lattice) == set()
    assert faulty_keys(UNPOLISHED, problem=lattice) == {"rung"}
    assert faulty_keys(POLISHED, problem=lattice) == {"termination"}


def test_a_geodesic_is_no_shorter_than_the_straight_line() -> None:
    """From the pivot at (12, 15) the goal is 23 m away."""
    geodesic = small_problem(cost_to_go="geodesic")
    near = replace(POLISHED, pivot=Pivot(np.array([12.0, 15.0]), 22.9))
    assert faulty_keys(near, problem=geodesic) == {"pivot.cost_m"}
    assert faulty_keys(near) == set()
    assert faulty_keys(POLISHED, problem=geodesic) == set()
