"""Plans and runs as JSON objects, as printed and as saved in ``plan.json`` and ``run.json``."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from pydantic_core import PydanticCustomError

from planopt.arrays import Floats
from planopt.channel.calibration import ReliabilityBin
from planopt.files.tables import LARGEST, REMEDY, encoded
from planopt.keys import input_error
from planopt.objectives.terms.term import Aim
from planopt.planning.certificate import (
    BlockedPath,
    Certificate,
    Crossing,
    Hole,
    Relaxation,
    excused_steps,
    worst_of_robots,
)
from planopt.planning.files.run_tables import drive_table
from planopt.planning.loop.log import Metrics, Outcome, RobotRun
from planopt.planning.loop.metrics import COSTS, run_holes, run_reliability
from planopt.planning.loop.results import Run, Solution, summary_of
from planopt.planning.plan import Pivot, Plan, Rung, Termination, Verdict, share_gained
from planopt.problems.problem import Problem


@dataclass(frozen=True)
class Source:
    """Function that computes the value of a key from the object to be saved."""

    value: Callable[[Any], object]


OMITTED = object()  # Value of a key that is left out of the JSON object

Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
NotNegative = Annotated[float, Field(ge=0)]
Place = Annotated[list[Number], Field(min_length=2, max_length=2)]
Computed = Annotated[Any, Field(default=None)]


class Record(BaseModel):
    """JSON object of a result, or part of one."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, frozen=True)

    @classmethod
    def written(cls, source: object, **values: object) -> dict[str, Any]:
        """Return the JSON data of an object; `values` take precedence over its attributes."""
        found: dict[str, Any] = {}
        for name, declared in cls.model_fields.items():
            if name not in values:
                own = next((each for each in declared.metadata if isinstance(each, Source)), None)
                values[name] = getattr(source, name) if own is None else own.value(source)
            if values[name] is not OMITTED:
                found[name] = encoded(values[name])
        return found

    @classmethod
    def read(cls, data: Mapping[str, Any], file: Path) -> Self:
        """Return the record in a file's JSON data, after validation."""
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            raise input_error(error, cls, file=file).remedied(REMEDY) from None


class Places(Record):
    """JSON object of positions along a path."""

    x_m: list[Number] = Field(default=[], max_length=10**6)
    y_m: list[Number] = Field(default=[], max_length=10**6)

    @model_validator(mode="after")
    def _have_both_coordinates(self) -> Self:
        if len(self.x_m) != len(self.y_m):
            raise PydanticCustomError("one_of", "x_m and y_m differ in length")
        return self

    @property
    def positions_m(self) -> Floats:
        """Return the positions (n, 2)."""
        return np.stack([self.x_m, self.y_m], axis=1).reshape(-1, 2)


def xy(positions_m: Floats) -> dict[str, Floats]:
    """Return positions (n, 2) as JSON data with separate keys for x and y."""
    return {"x_m": positions_m[:, 0], "y_m": positions_m[:, 1]}


class PivotRecord(Record):
    """JSON object of a plan's terminal waypoint, which lies beyond the horizon."""

    x_m: Annotated[Number, Source(lambda pivot: pivot.position_m[0])]
    y_m: Annotated[Number, Source(lambda pivot: pivot.position_m[1])]
    cost_m: NotNegative
    metre_cost: float = Field(default=1.0, ge=1, le=1e7)

    @property
    def pivot(self) -> Pivot:
        """Return the terminal waypoint as a `Pivot`."""
        return Pivot(np.array([self.x_m, self.y_m]), self.cost_m, self.metre_cost)


class AimRecord(Record):
    """JSON object of an objective's external inputs: expected target track and steering path."""

    target_x_m: Annotated[Computed, Source(lambda aim: _part(aim.target_m, np.s_[:, 0]))]
    target_y_m: Annotated[Computed, Source(lambda aim: _part(aim.target_m, np.s_[:, 1]))]
    steering_m: Annotated[Computed, Source(lambda aim: _part(aim.steering_turns_m, -1))]
    # In the order of travel
    steering_turns_m: Annotated[list[Place], Field(min_length=2)] | None = None
    # Positions of other robots' plans that affect the objective
    pending_m: Annotated[
        list[list[Place]], Source(lambda aim: aim.pending.planned_m or OMITTED)
    ] = Field(default=[])


def _part(array: Floats | None, at: Any) -> Floats | None:
    return None if array is None else array[at]


class HoleRecord(Record):
    """JSON object of a coverage hole, defined by its two ends on the path."""

    x_m: Annotated[Place, Source(lambda hole: (hole.from_m[0], hole.to_m[0]))]
    y_m: Annotated[Place, Source(lambda hole: (hole.from_m[1], hole.to_m[1]))]
    length_m: NotNegative
    min_connectivity: Annotated[
        float, Field(ge=0, le=1), Source(lambda hole: hole.least_connectivity)
    ]
    to_end: bool

    @property
    def hole(self) -> Hole:
        """Return the coverage hole as a `Hole`."""
        from_m, to_m = zip(self.x_m, self.y_m, strict=True)
        return Hole(from_m, to_m, self.length_m, self.min_connectivity, self.to_end)


class BlockedRecord(Places):
    """JSON object of a robot's cheapest path to a goal if every path violates a hard constraint."""

    robot: str
    holes: Annotated[list[HoleRecord], Source(lambda path: _holes(path.holes))]

    @property
    def path(self) -> BlockedPath:
        """Return the path as a `BlockedPath`."""
        return BlockedPath(self.robot, self.positions_m, tuple(each.hole for each in self.holes))


class CrossingRecord(Record):
    """JSON object of a path across coverage holes: its cost, and the best-connected alternative."""

    robot: str
    outage_price: Computed
    cost_m: NotNegative
    kept_m: NotNegative
    outside_m: NotNegative
    at_goal: Computed


class Trajectory(Places):
    """JSON object of a plan: its positions, current one first, and data from its planner."""

    x_m: list[Number] = Field(min_length=2)
    drive: Annotated[
        dict[str, list[Number | None]] | None,
        Source(lambda plan: OMITTED if plan.drive is None else drive_table(plan.drive)),
    ] = None
    termination: Annotated[Termination, Field(strict=False)]
    verdict: Computed
    rung: Annotated[Rung, Field(strict=False)]
    objective: Computed
    lattice_objective: float
    aim: AimRecord
    pivot: Annotated[
        PivotRecord | None, Source(lambda plan: plan.pivot and PivotRecord.written(plan.pivot))
    ] = None

    @property
    def residual(self) -> float | None:
        """Return the solver's KKT residual; None without refinement."""
        raise NotImplementedError


class Residual(Record):
    """JSON object of the certificate's entries that come from the solver."""

    kkt_residual: NotNegative | None


def _of_bound(name: str, missing: object = OMITTED) -> Source:
    """Return a `Source` that reads `name` from the proven bound; `missing` if there is none."""
    return Source(lambda of: missing if of.bound is None else getattr(of.bound, name))


class RobotPlan(Trajectory):
    """JSON object of one robot's plan in ``plan.json``."""

    name: Annotated[Computed, Source(lambda plan: plan.robot)]
    t_s: Computed
    connectivity: Computed
    wall_s: NotNegative
    solve_s: NotNegative
    iterations: int = Field(ge=0, le=10**9)
    certificate: Annotated[Residual, Source(lambda plan: certificate_json(plan.certificate))]
    polish_gain: Computed
    message: Computed
    rejected: Annotated[str, Source(lambda plan: plan.rejected or OMITTED)] = ""
    route: Annotated[Places | None, Source(lambda plan: xy(plan.route_m))] = None
    holes: Annotated[Computed, Source(lambda plan: _holes(plan.holes))]
    bound: Annotated[Computed, _of_bound("value")]
    gap: Annotated[Computed, _of_bound("gap")]
    bound_alone: Annotated[Computed, _of_bound("alone")]
    bound_method: Annotated[Computed, _of_bound("method")]
    bound_cost: Annotated[float | None, _of_bound("cost")] = None
    bound_relaxed: Annotated[Computed, _of_bound("relaxed")]
    bound_reason: Annotated[Computed, _of_bound("reason")]
    bound_wall_s: Annotated[Computed, _of_bound("wall_s")]

    @property
    def residual(self) -> float | None:
        """Return the solver's KKT residual; None without refinement."""
        return self.certificate.kkt_residual


class ReleasedPlan(Trajectory):
    """JSON object of a run's released plan, with the steps that violate the chance constraint."""

    kkt_residual: Annotated[NotNegative | None, Source(lambda plan: plan.certificate.kkt_residual)]
    relaxed_steps: Annotated[Computed, Source(lambda plan: plan.certificate.relaxed_steps)]
    relaxation_db: Annotated[Computed, Source(lambda plan: plan.certificate.relaxation_db)]
    best_margin_db: Annotated[Computed, Source(lambda plan: plan.certificate.best_margin_db)]
    path_cost_m: Annotated[Computed, Source(lambda plan: plan.certificate.path_cost_m)]
    best_cost_m: Annotated[Computed, Source(lambda plan: plan.certificate.best_cost_m)]

    @property
    def residual(self) -> float | None:
        """Return the solver's KKT residual; None without refinement."""
        return self.kkt_residual


def _written(record: type[Trajectory], problem: Problem, plan: Plan, aim: Aim) -> dict[str, Any]:
    """Return the JSON data of a robot's plan; some keys exist only for plans to a goal."""
    to_goal = ("pivot", "route", "holes", "path_cost_m", "best_cost_m")
    omitted = dict.fromkeys(to_goal if not problem.has_goal else (), OMITTED)
    values = {**xy(plan.positions_m), "aim": AimRecord.written(aim), **omitted}
    return record.written(plan, **values)


class Asked(NamedTuple):
    """JSON keys of a problem and its random seed."""

    problem: Problem
    seed: int


class Question(Record):
    """JSON keys of the settings for which a result was computed."""

    problem: Annotated[Computed, Source(lambda of: of.problem.name)]
    horizon: Annotated[Computed, Source(lambda of: of.problem.planner.horizon)]
    planner: Annotated[Computed, Source(lambda of: of.problem.planner.name)]
    cost_to_go: Annotated[Computed, Source(lambda of: of.problem.cost_to_go)]
    seed: int = Field(ge=0)


def _total(name: str) -> Source:
    return Source(lambda solution: sum(getattr(plan, name) for plan in solution.plans))


def _worst(name: str) -> Source:
    """Return a `Source` that reads the worst value of the label `name` over all plans."""

    def worst(solution: Solution) -> StrEnum:
        labels: list[StrEnum] = [getattr(plan, name) for plan in solution.plans]
        return max(labels, key=list(type(labels[0])).index)

    return Source(worst)


def _message(solution: Solution) -> str:
    plans, alone = solution.plans, len(solution.plans) == 1
    return "; ".join(
        plan.message if alone else f"{plan.robot}: {plan.message}" for plan in plans if plan.message
    )


def _gain(solution: Solution) -> float:
    plans = solution.plans
    gain, lattice = sum(plan.gain for plan in plans), sum(plan.lattice_objective for plan in plans)
    return share_gained(gain, lattice, sum(plan.objective for plan in plans))


_RELAXATIONS = TypeAdapter(tuple[Relaxation, ...])

Explanation = Annotated[tuple[Relaxation, ...], BeforeValidator(_RELAXATIONS.validate_python)]


class PlanRecord(Question):
    """JSON object of a solved problem; ``bound`` and ``gap`` are null without a proven bound."""

    termination: Annotated[Computed, _worst("termination")]
    verdict: Computed
    sense: Annotated[Computed, Source(lambda solution: solution.problem.sense)]
    objective: Annotated[Computed, _total("objective")]
    bound: Annotated[Computed, _of_bound("value", None)]
    gap: Annotated[Computed, _of_bound("gap", None)]
    bound_method: Annotated[Computed, _of_bound("method", None)]
    bound_cost: Annotated[Computed, _of_bound("cost", None)]
    bound_reason: Annotated[Computed, Source(lambda of: (of.bound and of.bound.reason) or OMITTED)]
    wall_s: Annotated[Computed, _total("wall_s")]
    solve_s: Annotated[Computed, _total("solve_s")]
    iterations: Annotated[Computed, _total("iterations")]
    certificate: Annotated[
        Computed,
        Source(
            lambda solution: certificate_json(
                worst_of_robots({plan.robot: plan.certificate for plan in solution.plans})
            )
        ),
    ]
    robots: list[RobotPlan] = Field(min_length=1)
    rung: Annotated[Computed, _worst("rung")]
    lattice_objective: Annotated[Computed, _total("lattice_objective")]
    polish_gain: Annotated[Computed, Source(_gain)]
    message: Annotated[Computed, Source(_message)]
    explanation: Explanation
    crossings: list[CrossingRecord] = Field(default=[])


class NoPlanRecord(Record):
    """JSON object of a result without a plan."""

    seed: int = Field(ge=0)
    message: str
    explanation: Explanation = ()
    robots: list[Any] = Field(max_length=0)


def solution_json(solution: Solution) -> dict[str, Any]:
    """Return the JSON object that ``planopt solve`` prints for a solution."""
    entries = solution.explanation
    return PlanRecord.written(
        solution,
        robots=[
            _written(RobotPlan, solution.problem, plan, aim)
            for plan, aim in zip(solution.plans, solution.aims, strict=True)
        ],
        explanation=[one for one in entries if isinstance(one, Relaxation)],
        crossings=[CrossingRecord.written(one) for one in entries if isinstance(one, Crossing)],
    )


def no_plan_json(
    problem: Problem,
    seed: int,
    message: str,
    explanation: Iterable[Relaxation] = (),
    blocked: Iterable[BlockedPath] = (),
) -> dict[str, Any]:
    """Return the JSON object of ``planopt solve`` if it is proven that no plan exists."""
    return {
        **dict.fromkeys(name for name in PlanRecord.model_fields if name != "bound_reason"),
        **Question.written(Asked(problem, seed)),
        "termination": Termination.NO_PATH.value,
        "verdict": Verdict.NONE.value,
        "sense": problem.sense,
        "certificate": no_certificate_json((message,)),
        "robots": [],
        "message": message,
        "explanation": encoded(list(explanation)),
        "crossings": [],
        **_blocked(blocked),
    }


def _blocked(paths: Iterable[BlockedPath]) -> dict[str, Any]:
    """Return a table with the key ``blocked``; empty if no path is blocked."""
    found = [BlockedRecord.written(one, **xy(one.path_m)) for one in paths]
    return {"blocked": found} if found else {}


def _holes(holes: Iterable[Hole]) -> list[dict[str, Any]]:
    return [HoleRecord.written(hole) for hole in holes]


def certificate_json(certificate: Certificate) -> dict[str, Any]:
    """Return the JSON data of a certificate, without the key ``rule`` under the default rule."""
    found: dict[str, Any] = encoded(certificate)
    if (rule := found["rule"]) is None:
        del found["rule"]
    else:
        rule["asked"] = rule.pop("required")
    return found


def no_certificate_json(reasons: Iterable[str]) -> dict[str, Any]:
    """Return the JSON keys of an empty certificate, with the reasons why there is no plan."""
    names = [part.name for part in fields(Certificate) if part.name != "rule"]
    lists = dict[str, Any](relaxed_steps=[], relaxation_db=[], best_margin_db=[])
    return {**dict.fromkeys(names), **lists, "reasons": list(reasons)}


class BinRecord(Record):
    """JSON object of a reliability bin: predicted against true connection, with an interval."""

    low: Computed
    high: Computed
    count: Computed
    groups: Computed
    predicted_connectivity: Annotated[Computed, Source(lambda one: one.predicted)]
    connected_share: Annotated[Computed, Source(lambda one: one.realised)]
    ci_low: Annotated[Computed, Source(lambda one: one.interval and one.interval[0])]
    ci_high: Annotated[Computed, Source(lambda one: one.interval and one.interval[1])]


class SummaryRecord(Record):
    """JSON object that summarises a run without its steps, as in comparisons."""

    problem: Computed
    horizon: Computed
    planner: Computed
    cost_to_go: Computed
    seed: int = Field(ge=0)
    outcome: str
    message: Annotated[str, Source(lambda summary: summary.reason)]
    metrics: Computed
    rungs: Computed
    verified_rate: Computed
    step_s: Annotated[Computed, Source(lambda summary: step_times_json(summary.step_s))]


class RobotPlans(Record):
    """JSON object of one robot's released plans."""

    robot: str
    released: list[ReleasedPlan]


class RunRecord(SummaryRecord):
    """JSON object of a closed-loop run."""

    reliability: Computed
    robots: Computed
    plans: list[RobotPlans]
    blocked: list[BlockedRecord] = Field(default=[])


class RobotRunRecord(Record):
    """JSON object of one robot's run: trajectory, metrics, excused steps and crossed holes."""

    name: Annotated[Computed, Source(lambda run: run.robot)]
    t_s: Annotated[Computed, Source(lambda run: run.log.t_s)]
    x_m: Annotated[Computed, Source(lambda run: run.log.positions_m[:, 0])]
    y_m: Annotated[Computed, Source(lambda run: run.log.positions_m[:, 1])]
    connectivity: Annotated[Computed, Source(lambda run: run.log.connectivity)]
    drive: Annotated[
        Computed, Source(lambda run: OMITTED if run.drive is None else drive_table(run.drive))
    ]
    path_m: Annotated[Computed, Source(lambda run: run.metrics.path_m)]
    true_connected_share: Annotated[Computed, Source(lambda run: run.metrics.true_connected_share)]
    longest_outage_m: Annotated[Computed, Source(lambda run: run.metrics.longest_outage_m)]
    measured_steps: Annotated[Computed, Source(lambda run: run.metrics.measured_steps)]
    rungs: Computed
    verified_rate: Computed
    excused: Computed
    holes: Annotated[Computed, Source(lambda run: _holes(run_holes(run)))]


def run_json(run: Run) -> dict[str, Any]:
    """Return the JSON object that ``planopt simulate`` prints for a run."""

    def robot(one: RobotRun, plans: Iterable[Plan]) -> dict[str, Any]:
        excused = excused_steps([plan.certificate for plan in plans])
        omitted = {} if run.problem.has_goal else {"holes": OMITTED}
        return RobotRunRecord.written(one, excused=excused, **omitted)

    return RunRecord.written(
        summary_of(run),
        reliability=reliability_json(run_reliability(run.runs)),
        robots=[robot(*each) for each in zip(run.runs, run.plans, strict=True)],
        plans=OMITTED,
        **{"blocked": OMITTED, **_blocked(run.blocked)},
    )


def released_plans_json(run: Run) -> list[dict[str, Any]]:
    """Return the value of ``plans`` in a saved run: released plans by robot, in order."""
    return [
        {
            "robot": one.robot,
            "released": [
                _written(ReleasedPlan, run.problem, plan, aim)
                for plan, aim in zip(made, known, strict=True)
            ],
        }
        for one, made, known in zip(run.runs, run.plans, run.aims, strict=True)
    ]


def no_run_json(problem: Problem, seed: int, message: str) -> dict[str, Any]:
    """Return the JSON object of ``planopt simulate`` if it is proven that no plan exists."""
    names = [name for name in RunRecord.model_fields if name not in ("plans", "blocked")]
    return {
        **dict.fromkeys(names),
        **Question.written(Asked(problem, seed)),
        "outcome": Outcome.NO_PLAN.value,
        "message": message,
        "metrics": dict.fromkeys([*(field.name for field in fields(Metrics)), *COSTS]),
        "rungs": {},
        "step_s": step_times_json(np.zeros(0)),
        "reliability": [],
        "robots": [],
    }


def reliability_json(bins: Iterable[ReliabilityBin]) -> list[dict[str, Any]]:
    """Return the JSON data of reliability bins."""
    return [BinRecord.written(one) for one in bins]


def step_times_json(seconds: Floats) -> dict[str, float | None]:
    """Return median, 95 % quantile and maximum of planning times; None without steps."""
    if seconds.size == 0:
        return {"p50": None, "p95": None, "max": None}
    p50, p95, largest = np.quantile(seconds, [0.5, 0.95, 1.0])
    return encoded({"p50": p50, "p95": p95, "max": largest})
