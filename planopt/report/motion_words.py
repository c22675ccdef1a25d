"""Problems, plans, certificates and runs of motion planning as lines of text, and live maps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite, isnan
from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.arrays import Floats
from planopt.planning.certificate import (
    Crossing,
    excused_in_words,
    excused_steps,
    goal_in_words,
    holes_in_words,
)
from planopt.planning.loop.metrics import run_holes, run_reliability
from planopt.planning.plan import Plan, Verdict
from planopt.problems.channel_setup import FittedTruth
from planopt.problems.problem import Problem, problem_of_robot
from planopt.report.tables import BAND_ENDS, BANDS, metric_name, reliability_lines, symbols_in_words
from planopt.short_repr import shown_number

if TYPE_CHECKING:
    from planopt.bounds.bound import Bound
    from planopt.planning.loop.results import Run, Solution

COLUMNS = 2  # Number of metrics per line

ORIGINS = {
    "plan": "refined path",
    "cold_retry": "path refined from another initial guess",
    "lattice": "lattice path",
    "relaxed": "path across a coverage hole",
    "direct": "shortest path",
    "give_way": "evasive path that lets other robots pass",
    "shifted": "last plan, shifted by one step",
    "stop": "stop",
    "leave": "retreat from an obstacle or robot that is too close",
    "reserved": "remainder of the last plan",
}
"""Text about the origin of a released path, by the name of the fallback in JSON."""

STOPPED = {
    "converged": "converged",
    "acceptable": "converged to its looser tolerance",
    "iteration_limit": "stopped at the iteration limit",
    "time_limit": "stopped at the time limit",
    "infeasible": "found no feasible point",
    "numerical_failure": "failed numerically",
    "no_path": "had no path to refine",
    "stopped": "stopped by the user",
}
"""Text about the termination of the solver, by its name in JSON."""

MEANING = {
    Verdict.VERIFIED: "constraints hold; contact is lost only if avoiding it costs more",
    Verdict.FEASIBLE_UNVERIFIED: "no violation found, but the proof is incomplete",
    Verdict.VIOLATED: "a constraint does not hold",
    Verdict.NONE: "there is no plan",
}


def solution_in_words(solution: Solution) -> list[str]:
    """Return the verdict, each plan, helpful changes, and reasons for crossing coverage holes."""
    problem, plans = solution.problem, solution.plans
    lines = [
        f"{problem.name}: {solution.verdict.value}, horizon {problem.planner.horizon} steps, "
        f"planner {problem.planner.name}, random seed {solution.seed}"
    ]
    if len(plans) > 1:
        total = sum(plan.objective for plan in plans)
        lines.append(f"  sum over {len(plans)} plans: {_value(problem, total)}")
        lines += [f"  {line}" for line in bound_in_words(problem, solution.bound, len(plans))]
    for number, plan in enumerate(plans):
        lines += [f"  {line}" for line in plan_in_words(problem_of_robot(problem, number), plan)]
        lines += [f"    {line}" for line in bound_in_words(problem, plan.bound)]
        own = [one for one in solution.explanation if one.robot == plan.robot]
        # The coverage holes are already listed.
        lines += [f"  {one.why if isinstance(one, Crossing) else one}" for one in own]
    return lines


def _value(problem: Problem, objective: float) -> str:
    """Return an objective value as text; with a goal, as a cost in seconds."""
    if problem.has_goal:
        return f"cost {shown_number(objective, ' s')} (travel time, control effort, outage penalty)"
    terms = ", ".join(dict.fromkeys(term.kind for term in problem.terms))
    return f"objective {shown_number(objective)} (weighted sum of terms: {terms}; larger is better)"


def _origin(plan: Plan) -> str:
    """Return text on the origin of a plan's path and on the solver's contribution."""
    count = f"{plan.iterations} iteration" + ("" if plan.iterations == 1 else "s")
    rung, stopped = plan.rung.value, plan.termination.value
    if stopped != "lattice_only":
        kept = ", which the solver did not improve" if rung == "lattice" else ""
        return f"{ORIGINS[rung]}{kept}; solver {STOPPED[stopped]} after {count}"
    origin = ORIGINS[rung] if rung != "plan" else "path found without the solver"
    return origin + (f", better than the solver's ({count})" if plan.iterations else "")


def plan_in_words(problem: Problem, plan: Plan) -> list[str]:
    """Return verdict, objective, distances, connectivity and coverage holes of a robot's plan."""
    proof, unit = plan.certificate, " s" if problem.has_goal else ""
    limited = problem.constraints.requires_connection or problem.has_goal
    lines = [
        f"{plan.robot}: {plan.verdict.value}; {_origin(plan)}; computed in "
        f"{shown_number(plan.wall_s, ' s', 2)}",
        f"  {_value(problem, plan.objective)}; initial guess "
        f"{shown_number(plan.lattice_objective, unit)}",
        f"  {planned_in_words(proof.min_clearance_m, proof.min_connectivity)}"
        + ("" if limited else " (no minimum required)"),
        *apart_in_words(proof.min_separation_m, proof.min_moving_clearance_m),
    ]
    if proof.rule is not None:
        lines.append(f"  {proof.rule.words}")
    if plan.rejected:
        lines.append(f"  the verifier rejected the refined path: {plan.rejected}")
    if plan.message:
        lines.append(f"  {plan.message}")
    if problem.has_goal:
        words = goal_in_words(problem, plan.holes)
        words += holes_in_words(problem, plan.holes, "the route to the goal crosses")
        lines += [f"  {line}" for line in words]
    return lines


def bound_in_words(problem: Problem, bound: Bound | None, plans: int = 1) -> list[str]:
    """Return a proven bound, or the reason for its absence, as lines of text."""
    if bound is None:
        return []
    if bound.value is None or bound.gap is None:
        return [f"no bound is proven: {bound.reason}"]
    s, one = ("", "plan") if plans == 1 else ("s", "set of plans")
    proven = f"no {one} can exceed an objective of {shown_number(bound.value)}"
    cost = f"the objective of the released plan{s} is {shown_number(bound.cost)}"
    if problem.sense == "min":
        proven = f"no {one} can cost less than {shown_number(bound.value, ' s')}"
        cost = (
            f"plan{s} and remaining route{s} cost {shown_number(bound.cost, ' s')} with the outage "
            "integrated along them"
        )
    lines = [
        f"proven bound: {proven}; {cost} (gap {100.0 * bound.gap:.2f} %; method: {bound.method})"
    ]
    if bound.relaxed:
        lines.append(f"the bound is valid but looser, as it ignores {' and '.join(bound.relaxed)}")
    return lines


def proof_in_words(problem: Problem, plan: Plan) -> list[str]:
    """Return verdict, requirements and residuals of a plan as text."""
    proof, limits = plan.certificate, problem.constraints
    residual = (
        "not refined"
        if proof.kkt_residual is None
        else f"KKT residual of the refinement {proof.kkt_residual:.2g}"
    )
    required = f"; required: clearance {limits.clearance_m:g} m"
    if limits.step_p_min > 0.0:
        required += f", P(connected) {limits.step_p_min:g}"
    lines = [
        f"  {plan.verdict.value}: {MEANING[plan.verdict]}{required}",
        f"  motion model satisfied to {proof.dynamics_defect:.2g} m; {residual}",
    ]
    if proof.relaxed_steps:
        lines.append(
            f"  P(connected) is too low at {len(proof.relaxed_steps)} of {len(plan.t_s) - 1} "
            f"steps, by at most {max(proof.relaxation_db):.2f} dB of received power"
        )
    return [*lines, *(f"  {reason}" for reason in proof.reasons)]


def run_in_words(run: Run) -> list[str]:
    """Return the outcome of a run and its metrics as text."""
    problem = run.problem
    planner = problem.planner
    origins = "; ".join(f"{ORIGINS.get(name, name)} ({count})" for name, count in run.rungs.items())
    robots = "1 robot" if len(run.runs) == 1 else f"{len(run.runs)} robots"
    steps = sum(len(one.log.t_s) - 1 for one in run.runs)
    measured = sum(one.metrics.measured_steps for one in run.runs)
    ahead = f", cost-to-go {problem.cost_to_go}" if problem.cost_to_go is not None else ""
    head = (
        f"{problem.name}: {run.outcome.value} ({run.reason}), horizon {planner.horizon} steps, "
        f"planner {planner.name}{ahead}, random seed {run.seed}"
    )
    if steps == 0:
        return [head, f"  {robots}, no step was driven"]
    lines = [
        f"{robots}; plans verified: {100.0 * run.verified_rate:.1f} %; "
        f"steps: {steps}; measurements: {measured}"
        + (" (all robots)" if len(run.runs) > 1 else ""),
        f"executed steps by type of path: {origins or 'none'}",
        *in_columns([*_metrics_in_words(run)]),
        *symbols_in_words(metric for metric, value in run.metrics.items() if not isnan(value)),
        *_unverified_in_words(run),
    ]
    if problem.has_goal:
        lines += _costs_in_words(run)
        for one in run.runs:
            crossed = f"{one.robot} crossed" if len(run.runs) > 1 else "crossed"
            lines += holes_in_words(problem, run_holes(one), crossed)
    lines += reliability_lines(run_reliability(run.runs), "steps")
    if isinstance(problem.channel.truth, FittedTruth):
        lines.append("the simulated channel is drawn from the fit to the log: no test of the fit")
    return [head, *(f"  {line}" for line in lines)]


def _metrics_in_words(run: Run) -> Iterator[tuple[str, str]]:
    """Yield name and value of each finite metric that a run's other lines do not show."""
    elsewhere = {"measured_steps", *BAND_ENDS}
    elsewhere |= {"realised_cost_m", "clairvoyant_cost_m"} if run.problem.has_goal else set()
    for metric, value in run.metrics.items():
        if metric in elsewhere or isnan(value):
            continue
        name = metric_name(metric)
        yield (
            name.words,
            f"{shown_number(name.scale * value)} {name.unit.removesuffix('1')}".strip(),
        )
        if metric in BANDS:
            low, high, words = BANDS[metric]
            yield f"NIS, {words}", f"{run.metrics[low]:.3g} to {run.metrics[high]:.3g}"


def _unverified_in_words(run: Run) -> list[str]:
    """Return text on each robot's number of unverified plans, and the reason for the last one."""
    lines: list[str] = []
    for plans in run.plans:
        missing = [plan for plan in plans if plan.verdict is not Verdict.VERIFIED]
        if missing:
            last = missing[-1]
            rule = last.certificate.rule
            why = "" if rule is None else rule.words
            lines.append(
                f"{last.robot}: {len(missing)} of {len(plans)} plans are not verified. Reason for "
                f"the last one: {last.message or why or last.verdict.value}"
            )
    return lines


def _costs_in_words(run: Run) -> list[str]:
    """Return text on a run's costs, their clairvoyant bound, and reasons for steps below p_min."""
    lines = [
        f"priced length of the run: {shown_number(run.costs['realised_cost_m'], ' m')} (length "
        f"plus {run.problem.reach.outage_price:g} m for each metre out of contact)",
        "priced length of the clairvoyant (lattice search that knows the true mean power): "
        f"{shown_number(run.costs['clairvoyant_cost_m'], ' m')}",
    ]
    proofs = [plan.certificate for made in run.plans for plan in made]
    excess_m = [proof.excess_m for proof in proofs if proof.excess_m is not None]
    if excess_m:
        lines.append(
            f"{len(excess_m)} of {len(proofs)} plans have steps below the required P(connected); "
            f"their priced length is at most {max(*excess_m, 0.0):.1f} m above the cheapest found"
        )
    return lines + [
        f"{made[0].robot}, {line}" if len(run.plans) > 1 else line
        for made in run.plans
        if made
        for line in excused_in_words(excused_steps([plan.certificate for plan in made]))
    ]


def words_ahead(problem: Problem, plans: Sequence[Plan]) -> Iterator[str]:
    """Yield the coverage holes on the route to each goal, according to the first plans."""
    if not problem.has_goal:
        return
    for number, plan in enumerate(plans):
        own = problem_of_robot(problem, number)
        name = f"{problem.name}, {plan.robot}" if len(plans) > 1 else problem.name
        for line in goal_in_words(own, plan.holes) + holes_in_words(
            own, plan.holes, "the route ahead crosses"
        ):
            yield f"{name}: {line}"


def problem_in_words(problem: Problem) -> list[str]:
    """Return a problem as lines of text."""
    planner, workspace, limits = problem.planner, problem.workspace, problem.constraints
    west, south, east, north = workspace.bounds_m
    truth, measured = problem.channel.truth, problem.channel.measurements
    source = getattr(truth, "file", None)
    kind = "simulated, drawn at random" if source is None else f"ground truth from {source}"
    if isinstance(truth, FittedTruth):
        kind = "simulated, drawn from the fit to the log"
    count = getattr(measured, "count", None)
    first = f"from {getattr(measured, 'file', None)}" if count is None else str(count)
    lines = [
        f"{problem.name}: {problem.description}",
        f"  task        {problem.task}, horizon {planner.horizon} steps of {planner.step_s:g} s, "
        f"run of at most {planner.max_steps} steps",
        f"  world       {east - west:g} x {north - south:g} m, "
        f"obstacles: {len(workspace.obstacles)} fixed"
        + (f", {len(workspace.moving)} moving" if workspace.moving else "")
        + (f", {len(workspace.timed)} temporary" if workspace.timed else ""),
        f"  channel     {'no ground truth' if truth is None else kind}; initial power "
        f"measurements: {first}",
    ]
    for radio in problem.stations:
        x, y = radio.site.position_m
        lines.append(
            f"  station     {radio.name} at ({x:g}, {y:g}) m, connected if the received power is "
            f"at least {radio.threshold_dbm:g} dBm"
        )
    for robot in problem.robots:
        goal = "" if robot.goal_m is None else " to ({:g}, {:g}) m".format(*robot.goal_m)
        lines.append(
            "  robot       {} from ({:g}, {:g}) m{}, at most {:g} m/s".format(
                robot.name, *robot.start_m, goal, robot.speed_max_m_s
            )
        )
    if limits.requires_connection:
        lines.append(f"  required    P(connected) of at least {limits.p_min:g}")
    lines.append(f"  clearance   {limits.clearance_m:g} m from obstacles")
    return lines


def in_columns(cells: Sequence[tuple[str, str]]) -> list[str]:
    """Return aligned lines of names with their values, `COLUMNS` pairs per line."""
    lines: list[str] = []
    sizes = [
        [max((len(cell[part]) for cell in cells[column::COLUMNS]), default=0) for part in (0, 1)]
        for column in range(COLUMNS)
    ]
    for begin in range(0, len(cells), COLUMNS):
        line = [
            f"{name:<{wide}} {value:>{number}}"
            for (name, value), (wide, number) in zip(
                cells[begin : begin + COLUMNS], sizes, strict=False
            )
        ]
        lines.append("    ".join(line))
    return lines


ALMOST_SURE = 0.9999  # Probability above which no further digits are shown


def planned_in_words(clearance_m: float | None, connectivity: float | None) -> str:
    """Return text on the clearance of planned paths and the minimum P(connected) of steps."""
    known = clearance_m is not None and isfinite(clearance_m)
    clear = f"a clearance of {shown_number(clearance_m, ' m')} from obstacles and " if known else ""
    lowest = shown_number(connectivity)
    if connectivity is not None and ALMOST_SURE < connectivity < 1.0:
        lowest = f"{ALMOST_SURE:g}"
    return f"the planned steps have {clear}a predicted P(connected) of at least {lowest}"


def apart_in_words(separation_m: float | None, moving_clearance_m: float | None) -> tuple[str, ...]:
    """Return text on minimum distances to other robots and moving obstacles; empty if none."""
    parts = [
        f"{shown_number(distance, ' m')} from {what}"
        for distance, what in (
            (separation_m, "other robots"),
            (moving_clearance_m, "moving obstacles"),
        )
        if distance is not None
    ]
    return (f"  always at least {', '.join(parts)}",) if parts else ()


FREE, OBSTACLE, DRIVEN, PLANNED, GOAL, STATION = " ", "#", ".", "o", "G", "^"
"""Characters of the map; robots have the digits from 1."""
ASPECT = 2.0  # Height over width of a character

DIGITS = "123456789"


class TerminalMap:
    """Text-mode map of a problem, with the paths driven so far."""

    def __init__(self, problem: Problem, columns: int, rows: int) -> None:
        x_min, y_min, x_max, y_max = problem.workspace.bounds_m
        # The wider of both scales, so that the whole world fits.
        self._cell_m = max((x_max - x_min) / columns, (y_max - y_min) / (ASPECT * rows))
        self._corner = np.array([x_min, y_max])
        shape = (
            max(1, min(rows, round((y_max - y_min) / (ASPECT * self._cell_m)))),
            max(1, min(columns, round((x_max - x_min) / self._cell_m))),
        )
        row, column = np.indices(shape)
        centre_x = x_min + self._cell_m * (column + 0.5)
        centre_y = y_max - ASPECT * self._cell_m * (row + 0.5)
        polygons = [each.polygon for each in problem.workspace.obstacles]
        union = shapely.union_all(polygons)
        shapely.prepare(union)
        blocked = shapely.contains_xy(union, centre_x.ravel(), centre_y.ravel()).reshape(shape)
        self._ground = np.where(blocked, OBSTACLE, FREE)
        self._problem = problem
        for mark, places in (
            (STATION, [each.position_m for each in problem.stations]),
            (GOAL, [each.goal_m for each in problem.robots if each.goal_m is not None]),
        ):
            self._put(self._ground, np.array(places, dtype=np.float64).reshape(-1, 2), mark)

    def frame(self, step: int, plans: Sequence[Plan]) -> str:
        """Return map and values of a step as text, and store the robots' positions."""
        picture = self._ground.copy()
        for number, plan in enumerate(plans):
            length = plan.positions_m[-1] - plan.positions_m[0]
            dense = max(2, int(np.abs(length).sum() / self._cell_m) * 2)
            at = np.linspace(0.0, len(plan.t_s) - 1.0, dense * len(plan.t_s))
            along = np.arange(len(plan.t_s), dtype=np.float64)
            ahead = [np.interp(at, along, plan.positions_m[:, axis]) for axis in (0, 1)]
            self._put(picture, np.stack(ahead, axis=1), PLANNED)
            self._put(picture, plan.positions_m[:1], DIGITS[number % len(DIGITS)])
            self._put(self._ground, plan.positions_m[:1], DRIVEN)
        edge = "+" + "-" * picture.shape[1] + "+"
        rows = ["|" + "".join(row) + "|" for row in picture.tolist()]
        return "\n".join([edge, *rows, edge, *step_lines(self._problem, step, plans)])

    def _put(self, picture: NDArray[np.str_], places_m: Floats, mark: str) -> None:
        """Write a character at all positions inside the picture."""
        cell = np.array([self._cell_m, -ASPECT * self._cell_m])
        column, row = np.floor((places_m - self._corner) / cell).astype(int).T
        inside = (row >= 0) & (row < picture.shape[0]) & (column >= 0) & (column < picture.shape[1])
        picture[row[inside], column[inside]] = mark


def step_lines(problem: Problem, step: int, plans: Sequence[Plan]) -> list[str]:
    """Return a line for each robot with its position and the values of its plan."""
    time_s = (step - 1) * problem.planner.step_s
    lines: list[str] = []
    for plan in plans:
        x, y = plan.positions_m[0]
        lines.append(
            f"{time_s:7.1f} s  {plan.robot} at ({x:.1f}, {y:.1f}) m: {plan.verdict.value}, "
            f"{plan.mean_dbm[0]:.1f} dBm, P(connected) {plan.connectivity[0]:.2f}, "
            f"at least {plan.connectivity.min():.2f} ahead"
        )
    return lines
