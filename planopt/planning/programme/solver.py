# pyright: basic
"""Rows of the path programme, and the interface to solvers of nonlinear programmes.

A robot with dynamics has variables w in addition to the positions q: for each step the remaining
components r_k of the state x_k = (q_k, r_k) and the input u_k. Its rows, with control points c_ki
of a step's curve and lines (n, b), are::

    step(x_{k-1}, u_k) - x_k   = 0     k = 1..N            "defect"
    limits(u_k, x_k)          <= 0     k = 1..N            "limit"
    stop_rows(x_N)             = 0                         "stop"
    n_kj . c_ki               >= b_kji k = 1..N, all i, j  "line_way"
    c_ki within the workspace          k = 1..N, all i     "box"

Braking after the last step is one more step with its own lines. Multipliers are positive at an
active upper bound and negative at an active lower bound (equation 6.10).
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import casadi as ca
import numpy as np

from planopt.arrays import Floats
from planopt.objectives.terms.term import Structure
from planopt.planning.plan import Termination
from planopt.robots.dynamics import Components, Dynamics

Point = Floats


@dataclass(frozen=True)
class Bounds:
    """Lower and upper bounds of rows or variables."""

    lower: Floats
    upper: Floats


@dataclass(frozen=True)
class NlpPoint:
    """Point returned by a solver, with its multipliers and status."""

    positions_m: Floats  # (N, 2)
    others: Floats  # Slacks in dB, then variables of the dynamics
    row_multipliers: Floats
    variable_multipliers: Floats
    termination: Termination
    iterations: int


def nlp_point(
    horizon: int,
    variables: Floats,
    row_multipliers: Floats,
    variable_multipliers: Floats,
    termination: Termination,
    iterations: int,
) -> NlpPoint:
    """Return a solver's point; `variables` contains the positions, then all others."""
    places, others = np.split(variables, [2 * horizon])
    return NlpPoint(
        places.reshape(horizon, 2),
        others,
        row_multipliers,
        variable_multipliers,
        termination,
        iterations,
    )


def lost_point(horizon: int, variables: int, rows: int) -> NlpPoint:
    """Return a point filled with NaN that marks a failed solve."""
    nothing = np.full(variables, np.nan)
    failure = Termination.NUMERICAL_FAILURE
    return nlp_point(horizon, nothing, np.full(rows, np.nan), nothing, failure, 0)


SolveNlp = Callable[[Point, Point, Bounds, Bounds], NlpPoint]
"""Solve function with arguments guess, parameters, variable bounds and row bounds."""


@dataclass(frozen=True)
class NlpFunctions:
    """Functions of a nonlinear programme with variables x and parameters p, and derivatives."""

    objective: Callable[[Point, Point], float]  # Maps (x, p) to the objective, minimised
    rows: Callable[[Point, Point], Point]  # Maps (x, p) to all rows
    # Maps (x, p) to the objective's gradient and the rows' Jacobian
    slopes: Callable[[Point, Point], tuple[Point, Point]]
    # Maps (x, p, multipliers) to the Hessian of objective + multipliers . rows
    hessian: Callable[[Point, Point, Point], Point]


def nlp_functions(solver: Any) -> NlpFunctions:
    """Return the functions of the nonlinear programme from a built CasADi solver."""
    f, g, df, dg, h = (
        _fast(solver.get_function(name), result)
        for name, result in (
            ("nlp_f", 0),
            ("nlp_g", 0),
            ("nlp_grad_f", 1),
            ("nlp_jac_g", 1),
            ("nlp_hess_l", 0),
        )
    )

    def slopes(at: Point, parameters: Point) -> tuple[Point, Point]:
        return df(at, parameters)[:, 0], dg(at, parameters)

    def hessian(at: Point, parameters: Point, by: Point) -> Point:
        upper = h(at, parameters, 1.0, by)
        return upper + np.triu(upper, 1).T

    return NlpFunctions(lambda *at: float(f(*at)[0, 0]), lambda *at: g(*at)[:, 0], slopes, hessian)


def _fast(function: Any, result: int) -> Callable[..., Floats]:
    """Return one result of a CasADi function as an array, faster than CasADi's own conversion."""
    shape, sparsity = function.size_out(result), function.sparsity_out(result)
    places = tuple(np.array(each, dtype=np.intp) for each in sparsity.get_triplet())

    def call(*arguments: Any) -> Floats:
        found, results = np.zeros(shape), function.call(arguments)
        found[places] = results[result].nonzeros()
        return found

    return call


def kkt_residual(
    gradient: Floats,
    jacobian: Floats,
    rows: Floats,
    row_bounds: Bounds,
    row_multipliers: Floats,
    variables: Floats,
    variable_bounds: Bounds,
    variable_multipliers: Floats,
) -> float:
    """Return the unscaled KKT residual at a point; infinite if any part is NaN."""
    # It is the maximum of stationarity, violation, wrong multiplier sign and complementarity.
    free = variable_bounds.lower < variable_bounds.upper
    stationarity = gradient + jacobian.T @ row_multipliers + variable_multipliers
    parts = [np.abs(stationarity[free])]
    for value, bounds, multiplier in (
        (rows, row_bounds, row_multipliers),
        (variables, variable_bounds, variable_multipliers),
    ):
        below, above = value - bounds.lower, bounds.upper - value
        parts += [np.maximum(-below, 0.0), np.maximum(-above, 0.0)]
        # A multiplier may only push away from its active bound.
        parts += [np.maximum(multiplier, 0.0) * _gap(above)]
        parts += [np.maximum(-multiplier, 0.0) * _gap(below)]
    # NumPy's maximum propagates NaN; Python's could lose it and report an exact point.
    worst = float(np.concatenate(parts).max(initial=0.0))
    return worst if np.isfinite(worst) else float("inf")


def _gap(distance: Floats) -> Floats:
    """Return distances to bounds, with 1 for infinite bounds because 0 * inf is NaN."""
    return np.where(np.isfinite(distance), np.abs(distance), 1.0)


TERMINATIONS: dict[str, Termination] = {
    "Solve_Succeeded": Termination.CONVERGED,
    "Solved_To_Acceptable_Level": Termination.ACCEPTABLE,
    "Infeasible_Problem_Detected": Termination.INFEASIBLE,
    "Search_Direction_Becomes_Too_Small": Termination.NUMERICAL_FAILURE,
    "Diverging_Iterates": Termination.NUMERICAL_FAILURE,
    "User_Requested_Stop": Termination.STOPPED,
    "Feasible_Point_Found": Termination.ACCEPTABLE,
    "Maximum_Iterations_Exceeded": Termination.ITERATION_LIMIT,
    "Restoration_Failed": Termination.NUMERICAL_FAILURE,
    "Error_In_Step_Computation": Termination.NUMERICAL_FAILURE,
    "Maximum_CpuTime_Exceeded": Termination.TIME_LIMIT,
    "Maximum_WallTime_Exceeded": Termination.TIME_LIMIT,
    "Not_Enough_Degrees_Of_Freedom": Termination.NUMERICAL_FAILURE,
    "Invalid_Problem_Definition": Termination.NUMERICAL_FAILURE,
    "Invalid_Option": Termination.NUMERICAL_FAILURE,
    "Invalid_Number_Detected": Termination.NUMERICAL_FAILURE,
    "Unrecoverable_Exception": Termination.NUMERICAL_FAILURE,
    "NonIpopt_Exception_Thrown": Termination.NUMERICAL_FAILURE,
    "Insufficient_Memory": Termination.NUMERICAL_FAILURE,
    "Internal_Error": Termination.NUMERICAL_FAILURE,
}
"""Termination for every status of IPOPT's interface."""


def termination_of(return_status: str) -> Termination:
    """Return the termination for a raw IPOPT status; unknown ones are numerical failures."""
    return TERMINATIONS.get(return_status, Termination.NUMERICAL_FAILURE)


OPTIONS: dict[str, Any] = {
    "print_time": False,
    "calc_lam_p": False,
    "no_nlp_grad": True,
    "show_eval_warnings": False,
    "error_on_fail": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.mu_init": 1e-2,
    "ipopt.tol": 1e-4,
    "ipopt.constr_viol_tol": 1e-6,
    "ipopt.acceptable_iter": 0,
    "ipopt.max_iter": 200,
}
"""Options of every solver. IPOPT's acceptable points are off, as they may violate rows by 1e-2."""


def call_nlp(
    solver: Any,
    horizon: int,
    start: Point,
    parameters: Point,
    variable_bounds: Bounds,
    row_bounds: Bounds,
) -> NlpPoint:
    """Return the point found by a CasADi solver; a point of NaN if CasADi rejects the input."""
    # `unified_return_status` hides infeasible and NaN; `success` has acceptable points.
    try:
        result = solver(
            x0=start,
            p=parameters,
            lbx=variable_bounds.lower,
            ubx=variable_bounds.upper,
            lbg=row_bounds.lower,
            ubg=row_bounds.upper,
        )
    except RuntimeError:
        return lost_point(horizon, len(start), len(row_bounds.lower))
    x, lam_g, lam_x = (np.asarray(result[name]).ravel() for name in ("x", "lam_g", "lam_x"))
    stats = solver.stats()
    if stats["return_status"] == "User_Requested_Stop":
        # CasADi turns an interrupt into this status.
        raise KeyboardInterrupt
    termination = termination_of(str(stats["return_status"]))
    return nlp_point(horizon, x, lam_g, lam_x, termination, int(stats.get("iter_count", 0)))


@dataclass(frozen=True)
class MotionShape:
    """Sizes of the variables, parameters and constraint rows that describe a robot's dynamics."""

    dynamics: Dynamics
    step_s: float  # Duration of a step
    horizon: int
    lines: int  # Separating lines per segment

    @property
    def rest(self) -> int:
        """Return the number of state components other than the position."""
        return len(self.dynamics.state_names) - 2

    @property
    def per_step(self) -> int:
        """Return the number of variables per step."""
        return self.rest + len(self.dynamics.input_names)

    @property
    def variables(self) -> int:
        """Return the number of variables w of the dynamics."""
        return self.horizon * self.per_step

    @property
    def parameters(self) -> int:
        """Return the number of parameters: initial state without position, and braking lines."""
        return self.rest + 4 * self.lines


@dataclass(frozen=True)
class PathShape:
    """Structure of the nonlinear programme of a path."""

    horizon: int
    lines: int  # Separating lines per segment
    structure: Structure  # Coupling of the stages by the value
    bounded: bool = False  # Whether each stage's connectivity is bounded
    summed: bool = False  # Whether a sum over stages is bounded instead
    motion: MotionShape | None = None  # Rows of the dynamics; None for the single integrator
    charged: bool = False  # Whether the cost of reaching a goal is subtracted
    valued: bool = True  # Whether there is a value besides
    slacked: bool = True  # Whether slacks may relax the connectivity bounds

    @property
    def priced(self) -> bool:
        """Return whether a single integrator pays for reaching a goal, and for outage."""
        return self.charged and self.motion is None

    @property
    def bounds(self) -> int:
        """Return the number of connectivity rows: one per stage, one for a sum, or none."""
        return self.horizon if self.bounded else int(self.summed)

    @property
    def slacks(self) -> int:
        """Return the number of slacks: one per connectivity row, or none."""
        return self.bounds if self.slacked else 0

    @property
    def driven(self) -> int:
        """Return the number of variables of the robot's dynamics."""
        return 0 if self.motion is None else self.motion.variables

    @property
    def variables(self) -> int:
        """Return the number of all variables: positions, slacks, and dynamics."""
        return 2 * self.horizon + self.slacks + self.driven

    @property
    def per_m(self) -> Floats:
        """Return the trust-region width of each variable if that of positions is 1 m."""
        places, slacks = np.ones(2 * self.horizon), np.full(self.slacks, np.inf)
        if self.motion is None:
            return np.concatenate([places, slacks])
        units = np.array(self.motion.dynamics.unit_m(self.motion.step_s)[2:])
        inputs = np.full(self.motion.per_step - len(units), np.inf)
        step = np.concatenate([1.0 / units, inputs])
        return np.concatenate([places, slacks, np.tile(step, self.horizon)])


def path_rows(n: int, lines: int, q: Any, start: Any, line: Any) -> Any:
    """Return the constraint rows "speed", "line_end" and "line_start" as one vector."""
    speed, line_end, line_start = [], [], []
    for k in range(n):
        here = q[2 * k : 2 * k + 2]
        before = start if k == 0 else q[2 * k - 2 : 2 * k]
        speed.append(ca.sumsqr(here - before))
        for j in range(lines):
            at = 4 * (k * lines + j)
            line_end.append(line[at] * here[0] + line[at + 1] * here[1] - line[at + 2])
            if k > 0:
                line_start.append(line[at] * before[0] + line[at + 1] * before[1] - line[at + 3])
    return ca.vertcat(*speed, *line_end, *line_start)


@dataclass(frozen=True)
class MotionRows:
    """Constraint rows of the dynamics, each kind as a list of expressions or numbers."""

    defect: list[Any]
    limit: list[Any]
    stop: list[Any]
    line_way: list[Any]
    box_x: list[Any]
    box_y: list[Any]

    def stacked(self) -> list[Any]:
        """Return all constraint rows in one list, in the order of the fields."""
        return [row for each in fields(self) for row in getattr(self, each.name)]

    def bounds(self, bounds_m: tuple[float, float, float, float]) -> tuple[Floats, Floats]:
        """Return lower and upper bounds of all constraint rows in the workspace `bounds_m`."""
        x_min, y_min, x_max, y_max = bounds_m
        limits = {
            "limit": (-np.inf, 0.0),
            "line_way": (0.0, np.inf),
            "box_x": (x_min, x_max),
            "box_y": (y_min, y_max),
        }
        each = [
            limits.get(own.name, (0.0, 0.0))
            for own in fields(self)
            for _ in getattr(self, own.name)
        ]
        lower, upper = np.array(each, dtype=np.float64).T
        return lower, upper


def motion_rows(shape: MotionShape, q: Any, w: Any, start: Components, line: Any) -> MotionRows:
    """Return the constraint rows of the dynamics for positions `q` (2 N,) and variables `w`."""
    dynamics, step_s = shape.dynamics, shape.step_s
    rows = MotionRows([], [], [], [], [], [])
    before = start
    for k in range(shape.horizon):
        own = [w[k * shape.per_step + i] for i in range(shape.per_step)]
        control = tuple(own[shape.rest :])
        here = (q[2 * k], q[2 * k + 1], *own[: shape.rest])
        reached = dynamics.step(before, control, step_s)
        rows.defect.extend(there - at for there, at in zip(reached, here, strict=True))
        rows.limit.extend(dynamics.limits(control, here))
        _hull_rows(rows, shape, dynamics.control_points(before, control, step_s), line, k)
        before = here
    rows.stop.extend(dynamics.stop_rows(before, step_s))
    _hull_rows(rows, shape, dynamics.stop_points(before, step_s), line, shape.horizon)
    return rows


def _hull_rows(
    rows: MotionRows,
    shape: MotionShape,
    points: tuple[tuple[Any, Any], ...],
    line: Any,
    segment: int,
) -> None:
    """Append the rows that keep one step's curve in the workspace and clear of obstacles."""
    for number, (x, y) in enumerate(points, start=1):
        share = number / (len(points) + 1)
        for j in range(shape.lines):
            at = 4 * (segment * shape.lines + j)
            end, start = line[at + 2], line[at + 3]
            offset = end + (1.0 - share) * (start - end)
            rows.line_way.append(line[at] * x + line[at + 1] * y - offset)
        rows.box_x.append(x)
        rows.box_y.append(y)
