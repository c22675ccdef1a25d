"""Replay and verification of a saved plan or run from its files alone, and loading of results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Floats
from planopt.bounds.bound import GAP_TOLERANCE, Bound, Potential, Tilts
from planopt.channel.cholesky import one_blas_thread
from planopt.channel.kriging import Prediction
from planopt.channel.measurements import SAME_PLACE_M, Measurements
from planopt.channel.posterior import Belief, condition
from planopt.errors import InputError, NoPlanError
from planopt.files.compare import DIGEST, EXACT, differences, digest, in_words, same
from planopt.files.tables import REMEDY
from planopt.objectives.moments import Region
from planopt.planning.certificate import (
    BlockedError,
    Certificate,
    holes_on,
    worst_of,
    worst_of_robots,
)
from planopt.planning.files.belief_file import BOUND_FILE, Arrays, SavedBelief, station_prefix
from planopt.planning.files.result_json import (
    NoPlanRecord,
    PlanRecord,
    RobotPlan,
    RunRecord,
    no_plan_json,
    no_run_json,
)
from planopt.planning.files.run_tables import KNOWLEDGE_COLUMNS, KNOWLEDGE_FILE, STEPS_FILE
from planopt.planning.files.saved import FORMAT, PLAN_FILE, Saved, SavedPlan, contents, saved_from
from planopt.planning.free_space import build_roads, is_joined, obstacles_met, with_drawn_starts
from planopt.planning.initial_data import (
    InitialData,
    Prepared,
    draw_initial_data,
    learn_stations,
    team_seeds,
)
from planopt.planning.loop.drive import World, drive, true_world
from planopt.planning.loop.log import Outcome
from planopt.planning.loop.metrics import COSTS
from planopt.planning.loop.results import Run, Solution
from planopt.planning.plan import Plan, Rung, Verdict
from planopt.planning.proof.bounds import verified_bound, verified_sum
from planopt.planning.proof.rule import VerifierContext, search_prediction, verifier_context
from planopt.planning.proof.searches import GoalGrid
from planopt.planning.proof.verify import verify
from planopt.planning.reservations import discs_to_avoid, others_of
from planopt.planning.stepping import Planning, PlanStep, Stepper, TeamMoment, watch_target
from planopt.planning.values.context import (
    Aim,
    StepContext,
    counts_others,
    places_of_others,
    step_context,
    workspace_region,
)
from planopt.planning.values.objective_value import LeadingPivot, ObjectiveValue, ReachCost
from planopt.problems.library import SUFFIX, library_folder
from planopt.problems.load import load_motion, problem_to_dict
from planopt.problems.problem import Problem, problem_at, problem_of_robot
from planopt.problems.tasks import Contents
from planopt.short_repr import short_repr
from planopt.world.clearance import index_obstacles

VALUES, NOISE = "values_db", "noise_variance_db2"
"""Names of the saved arrays of the expectation-propagation (EP) sites."""


def initial_belief(problem: Problem, first: Sequence[Measurements], saved: SavedBelief) -> Belief:
    """Return the belief before the first step, fitted again with the saved channel parameters."""
    # Fits on different machines differ slightly; saved and refitted parameters are compared.
    learnt = learn_stations(problem, first)
    each = [
        _with_parameters(replace(own, further=()), record)
        for own, record in zip((learnt, *learnt.further), saved.stations, strict=True)
    ]
    return replace(each[0], further=tuple(each[1:]))


def _with_parameters(belief: Belief, saved: SavedBelief) -> Belief:
    """Return the belief conditioned on the saved channel parameters."""
    learnt = belief.posterior
    if saved.parameters == learnt.parameters:
        return belief
    posterior = condition(
        saved.parameters, learnt.measurements, theta="known" if learnt.theta_known else "estimated"
    )
    return replace(belief, posterior=posterior)


def belief_reasons(saved: SavedBelief, found: Arrays, seed: int) -> list[str]:
    """Return the differences between the saved arrays and the recomputed ones."""
    record = {
        station_prefix(station) + name: array
        for station, own in enumerate(saved.stations)
        for name, array in own.arrays.items()
    }
    return in_words(
        saved.file.name,
        differences(_comparable(record), _comparable(found)),
        f"found with seed {seed}",
    )


def _comparable(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Return arrays as lists, with expectation-propagation sites as natural parameters."""
    lists: dict[str, Any] = {name: array.tolist() for name, array in arrays.items()}
    for name, variance in arrays.items():
        values = arrays.get(name.removesuffix(NOISE) + VALUES)
        if name.endswith(NOISE) and values is not None and values.shape == variance.shape:
            lists[name] = {"precision": (1.0 / variance).tolist()}
            lists[name.removesuffix(NOISE) + VALUES] = {
                "precision_mean": (values / variance).tolist()
            }
    return lists


def start_of(saved: Saved) -> tuple[Prepared, list[str]]:
    """Return the initial data of a saved result, and remarks on data that cannot be drawn again."""
    problem, seed = saved.problem, saved.record.seed
    first = [own.measurements.take(slice(own.first)) for own in saved.beliefs[0].stations]
    remarks: list[str] = []
    try:
        data = draw_initial_data(problem, seed)
    except InputError as error:
        remarks.append(f"first measurements are taken from the file, as none can be drawn: {error}")
        try:
            data = draw_initial_data(problem, seed, first)
        except InputError:  # A file of the ground truth is missing
            data = InitialData((), tuple(first))
    if not data.truths:
        remarks.append("true powers are taken from the file, which has no ground truth")
    belief = initial_belief(problem, data.measurements, saved.beliefs[0])
    return Prepared(data.truths, belief), remarks


def replayed(saved: Saved, start: Prepared) -> Solution | Run:
    """Verify every plan of a saved solution or run again, and return the result."""
    problem, seed, planning = saved.problem, saved.record.seed, _planning(saved)
    generator = team_seeds(problem, seed).target
    target = watch_target(problem, generator)
    if isinstance(saved.record, PlanRecord):
        robots = Stepper(problem, start.belief, planning, target)
        plans = tuple(robots.plan())
        aims = tuple(aim for (aim,) in robots.aims)
        return Solution(problem, seed, start.belief, plans, aims, saved.explanation(plans))
    world = _saved_world(saved)
    if start.truths:
        led = range(len(problem.robots) if problem.has_goal else 0)
        owns = [problem_of_robot(problem, number) for number in led]
        goals = [(own, np.asarray(own.goal_m)) for own in owns]
        world = true_world(problem, start.truths, lambda: [build_roads(*each) for each in goals])
    return drive(problem, seed, start.belief, world, planning, target, generator)


def _saved_world(saved: Saved) -> World:
    """Return a simulated world that reproduces true powers, measurements and costs from files."""
    problem = saved.problem

    def serving_dbm(number: int, step: int, places_m: Floats) -> Floats:
        steps = saved.tables[STEPS_FILE]
        rows = steps["true_db"][steps["robot"] == problem.robots[number].name][step:]
        found = np.full(len(places_m), np.nan)
        found[: len(rows)] = rows[: len(places_m)]
        return found

    def measured(step: int, places_m: Floats) -> list[list[Measurements]]:
        shared = problem.channel.share_measurements
        return [
            [_taken(own, step, place) for own in saved.beliefs[0 if shared else number].stations]
            for number, place in enumerate(places_m)
        ]

    def row(step: int, *_: object) -> tuple[float, ...]:
        table = saved.tables[KNOWLEDGE_FILE]
        names = [column.name for column in KNOWLEDGE_COLUMNS[1:]]
        return tuple(float(table[name][min(step, len(table[name]) - 1)]) for name in names)

    def costs(*_: object) -> dict[str, float]:
        record: dict[str, Any] = dict(saved.data.get("metrics", {}))
        return {key: float(np.array(record[key], dtype=float)) for key in COSTS if key in record}

    return World((), serving_dbm, measured, row, costs)


def _taken(own: SavedBelief, step: int, place_m: Floats) -> Measurements:
    """Return the saved measurements of a step at a position."""
    counts = [*own.known_before_step.tolist(), len(own.measurements)]
    rows = np.arange(*(counts[step - 1 : step + 1] if step < len(counts) else (0, 0)))
    away = np.linalg.norm(own.measurements.positions_m[rows] - place_m, axis=1)
    return own.measurements.take(rows[away <= SAME_PLACE_M])


def _planning(saved: Saved) -> Planning:
    """Return a planning function that yields the saved trajectories, each verified again."""
    by_robot = saved.plans

    def made(problem: Problem, states: Sequence[Floats]) -> PlanStep:
        owns = [problem_of_robot(problem, number) for number in range(len(problem.robots))]
        index = index_obstacles(problem.workspace)
        region = None if problem.has_goal else workspace_region(problem)
        grids: list[GoalGrid | None] = [None for _ in owns]

        def plan_step(at: TeamMoment) -> tuple[list[Plan], list[Aim]]:
            step = at.driven
            if step >= len(by_robot[0]):
                raise _no_plan(saved, owns, at.states)
            motions = [made[step].motion for made in by_robot]
            plans: list[Plan] = []
            aims: list[Aim] = []
            for number, own in enumerate(owns):
                moving = discs_to_avoid(problem, step, others_of(motions, number))
                posteriors = at.beliefs[number].posteriors
                under = verifier_context(
                    own,
                    index,
                    posteriors,
                    at.states[number],
                    at.histories[number],
                    moving,
                    grids[number],
                )
                aim = by_robot[number][step].aim(at.watched[number])
                if counts_others(own):
                    driven_m = places_of_others(at.driven_m, number)
                    aim = replace(aim, pending=replace(aim.pending, driven_m=driven_m))
                plans.append(_verified_again(under, region, aim, by_robot[number][step], len(owns)))
                aims.append(aim)
                grids[number] = under.laid_grid
            return plans, aims

        return plan_step

    return made


def _no_plan(saved: Saved, owns: Sequence[Problem], states: Sequence[Floats]) -> BlockedError:
    """Return the error that ended a run, with the saved reason if this can be verified."""
    # Valid reasons are obstacles that cut off a goal and a blocked path from a robot's position.
    steps = len(saved.plans[0])
    message = (
        f"the run ends after step {steps}, planner.max_steps is "
        f"{saved.problem.planner.max_steps}, and neither its task nor a standstill ended it"
    )
    places = {own.robots[0].name: state[:2] for own, state in zip(owns, states, strict=True)}
    hard = saved.problem.constraints.rule.slack_max_db is not None
    shown = hard and any(
        path.holes and np.abs(path.path_m[0] - places[path.robot]).max() <= SAME_PLACE_M
        for path in saved.blocked
    )
    for own in owns if saved.problem.has_goal else ():
        x, y = places[own.robots[0].name].tolist()
        here = replace(own, robots=(replace(own.robots[0], start_m=(x, y)),))
        shown = shown or not is_joined(here, here.constraints.clearance_m)
    has_no_plan = saved.data.get("outcome") == Outcome.NO_PLAN.value
    if has_no_plan and shown:
        message = str(saved.data.get("message"))
    return BlockedError(message, saved.blocked)


def _verified_again(
    context: VerifierContext,
    region: Region | None,  # None for runs to a goal
    aim: Aim,
    saved: SavedPlan,
    robots: int,
) -> Plan:
    """Return a saved plan with all results recomputed from its trajectory."""
    problem, record, drive, path_m = context.problem, saved.record, saved.drive, saved.path_m.copy()
    path_m[0] = context.state[:2]
    if drive is not None:
        drive = replace(drive, states=np.vstack([context.state, drive.states[1:]]))
    verification = verify(context, path_m, record.residual, drive)
    power = verification.power
    if power is None:
        raise AssertionError("saved places are finite")
    step: StepContext | None = None
    if region is None:

        def certified(places_m: Floats) -> Prediction:
            known = np.array_equal(places_m, path_m)
            return power if known else search_prediction(context.law, places_m)

        pivot, priced = saved.pivot, record.rung is not Rung.DIRECT
        ahead: LeadingPivot | None = None if pivot is None else lambda _: pivot
        objective = ReachCost(problem, path_m[0], certified, ahead, priced)(path_m[1:], drive)
    else:
        step = step_context(replace(context, state=path_m[0]), region, aim)
        objective = ObjectiveValue(step)(path_m[1:])
    plan = verification.plan(
        problem, path_m, objective, record.lattice_objective, record.rung, record.termination, drive
    )
    plan = replace(plan, pivot=saved.pivot)
    if not isinstance(record, RobotPlan):
        return plan
    planned = ("wall_s", "solve_s", "iterations", "rejected")
    plan = replace(plan, **{name: getattr(record, name) for name in planned})
    if problem.has_goal and record.route is not None:
        route_m = record.route.positions_m
        places = np.vstack([path_m, route_m])
        holes = holes_on(problem, search_prediction(context.law, places), places)
        plan = replace(plan, route_m=route_m, holes=holes)
    if record.bound_cost is None:
        return plan
    certificate = saved.certificate
    if step is not None:
        tilts = certificate if isinstance(certificate, Tilts) else None
        return replace(plan, bound=verified_sum(problem, step, plan, step.moving, tilts))
    potential = certificate if isinstance(certificate, Potential) else None
    bound = verified_bound(problem, context.posteriors, plan, potential, robots)
    return replace(plan, bound=bound)


def plan_reasons(problem: Problem, plan: Plan) -> list[str]:
    """Return the verifier's reasons to reject a plan of the problem's first robot."""
    if plan.verdict is Verdict.VERIFIED:
        return []
    index = index_obstacles(problem.workspace)
    met = [] if plan.drive is not None else obstacles_met(problem, index, plan.positions_m)
    return [*met, *plan.certificate.reasons]


def library_remarks(file: str, problem: Problem, seed: int = 0) -> list[str]:
    """Return the differences between a saved problem and the library's problem of that name."""
    # Horizon, planner and cost-to-go are not compared because the file stores them separately.
    original = library_folder() / f"{problem.name}{SUFFIX}"
    if not original.is_file():
        return [
            f"{file}, key problem_file.problem.name: {problem.name} is not in the library, so that "
            "it is not compared"
        ]
    try:
        meant = _but_overrides(problem_to_dict(with_drawn_starts(load_motion(original), seed)))
    except InputError as error:
        return [f"{file}, key problem_file: cannot be compared with the library's: {error}"]
    saved_data = _but_overrides(problem_to_dict(problem))
    remarks: list[str] = []
    if problem.channel.truth is None and "truth" in meant["channel"]:
        remarks.append(
            f"{file}, key problem_file.channel: has no ground truth and no first measurements, as "
            f"where they are from Python; the library's {problem.name} has"
        )
        for tables in (saved_data, meant):
            channel = {key: value for key, value in tables["channel"].items() if key != "truth"}
            measured = {k: v for k, v in channel["measurements"].items() if k != "count"}
            tables["channel"] = {**channel, "measurements": measured}
    found = differences(saved_data, meant, "problem_file", accepted=frozenset())
    return remarks + in_words(file, found, f"in the library's {problem.name}")


def _but_overrides(tables: dict[str, Any]) -> dict[str, Any]:
    """Return a problem's tables without settings that the command line can override."""
    without = {"planner": ("horizon", "name"), "objective": ("cost_to_go",)}
    return {
        table: {key: value for key, value in keys.items() if key not in without[table]}
        if table in without
        else keys
        for table, keys in tables.items()
    }


@dataclass(frozen=True)
class CheckResult:
    """Result of checking a saved plan or run."""

    verdict: Verdict  # ``verified`` or ``violated``; ``none`` if there is no plan
    # Certificates of the repeated verification: one for a plan, one per step of a run
    certificates: tuple[Certificate, ...]
    reasons: tuple[str, ...]  # All objections; empty if verified
    # Notes: parts that could not be checked, differences from the library's problem of that name
    remarks: tuple[str, ...] = ()

    __repr__ = short_repr

    @property
    def certificate(self) -> Certificate | None:
        """Return the certificate of a plan, or the worst values of a run; None without plans."""
        if len(self.certificates) <= 1:
            return self.certificates[0] if self.certificates else None
        return _worst(self.certificates)


@one_blas_thread()
def check_motion(file: Path, data: Mapping[str, Any]) -> CheckResult:
    """Return the result of checking a saved plan or run, from its loaded JSON object."""
    saved = saved_from(file, data)
    name = saved.file.name
    remarks = library_remarks(name, saved.problem, saved.record.seed)
    if isinstance(saved.record, NoPlanRecord):
        return CheckResult(Verdict.NONE, (), tuple(_no_plan_reasons(saved)), tuple(remarks))
    made: tuple[tuple[Plan, ...], ...] = ()
    try:
        start, found = start_of(saved)
    except InputError as error:
        reasons = [f"{saved.beliefs[0].file.name}: the channel cannot be fitted again: {error}"]
    else:
        remarks += found
        result = replayed(saved, start)
        made = (
            tuple(zip(*result.plans, strict=True)) if isinstance(result, Run) else (result.plans,)
        )
        reasons = [*_objections(saved, result), *_different(saved, contents(result))]
    verdict = Verdict.VIOLATED if reasons else Verdict.VERIFIED
    certificates = tuple(
        worst_of_robots({plan.robot: plan.certificate for plan in plans}) for plans in made
    )
    return CheckResult(verdict, certificates, tuple(reasons), tuple(remarks))


def _objections(saved: Saved, result: Solution | Run) -> list[str]:
    """Return the verifier's reasons to reject plans of a replayed result."""
    if isinstance(result, Solution):
        return [
            f"{plan.robot}: {reason}" if len(result.plans) > 1 else reason
            for number, plan in enumerate(result.plans)
            for reason in [
                *plan_reasons(problem_of_robot(saved.problem, number), plan),
                *_bound_reasons(saved, number, plan.bound),
            ]
        ]
    reasons: list[str] = []
    for number, plans in enumerate(result.plans):
        for step, plan in enumerate(plans):
            own = problem_of_robot(problem_at(saved.problem, step), number)
            where = f"plans[{number}].released[{step}], the plan for step {step + 1}"
            reasons += [
                f"{saved.file.name}, key {where}: {reason}" for reason in plan_reasons(own, plan)
            ]
    if len(result.plans[0]) < len(saved.plans[0]):
        late = f"the run goes on after step {len(result.plans[0])}, {result.reason}"
        reasons.append(f"{saved.file.name}, key plans: {late}")
    return reasons


def _bound_reasons(saved: Saved, number: int, bound: Bound | None) -> list[str]:
    """Return the reasons to reject the bound of a robot's plan."""
    claimed = saved.data["robots"][number].get("bound")
    if bound is None or claimed is None:
        return []
    reasons = gap_reasons(bound.gap)
    if not same(claimed, bound.value, EXACT):
        has_one = saved.plans[number][0].certificate is not None
        fault = "does not prove the bound" if has_one else "is missing"
        reasons.append(f"{BOUND_FILE}: the certificate of the bound {fault}")
    return reasons


def gap_reasons(gap: float | None) -> list[str]:
    """Return the reason to reject a result that is better than its proven bound."""
    if gap is None or gap >= -GAP_TOLERANCE:
        return []
    return [f"the gap is {gap:.2g}: the result is better than its proven bound"]


def _different(saved: Saved, found: Contents) -> list[str]:
    """Return the differences between the saved files and the replayed result."""
    # The problem is excluded because library_remarks compares it.
    data = {**found.data, DIGEST: digest(saved.data), "problem_file": saved.data["problem_file"]}
    reasons = in_words(found.file, differences(saved.data, data))
    reasons += found.table_reasons(saved.tables)
    for belief in saved.beliefs:
        reasons += belief_reasons(belief, found.arrays[belief.file.name], saved.record.seed)
    return reasons


def _no_plan_reasons(saved: Saved) -> list[str]:
    """Return differences between a saved result without a plan and the recomputed one."""
    message, record = str(saved.data["message"]), saved.record
    found: dict[str, Any]
    if saved.file.name == PLAN_FILE and isinstance(record, NoPlanRecord):
        found = no_plan_json(saved.problem, record.seed, message, record.explanation)
    else:
        found = {**no_run_json(saved.problem, record.seed, message), "plans": []}
    found |= {"format": FORMAT, DIGEST: digest(saved.data)}
    found |= {key: saved.data[key] for key in ("problem_file", "blocked") if key in saved.data}
    words = in_words(saved.file.name, differences(saved.data, found))
    return [f"there is no plan to verify: {message}", *words]


def _worst(certificates: Sequence[Certificate]) -> Certificate:
    """Return a certificate with the worst values over a run."""
    missed = [
        (step, certificate)
        for step, certificate in enumerate(certificates, start=1)
        if 1 in certificate.relaxed_steps
    ]
    return replace(
        worst_of(certificates),
        posterior=certificates[-1].posterior,
        relaxed_steps=tuple(step for step, _ in missed),
        relaxation_db=tuple(c.relaxation_db[0] for _, c in missed),
        best_margin_db=tuple(c.best_margin_db[0] for _, c in missed if c.best_margin_db),
    )


@one_blas_thread()
def load_motion_result(file: Path, data: Mapping[str, Any]) -> Solution | Run:
    """Return a saved plan or run, as :func:`planopt.load_result` does."""
    saved = saved_from(file, data)
    if isinstance(saved.record, NoPlanRecord):
        raise NoPlanError(saved.record.message)
    result, record = replayed(saved, start_of(saved)[0]), saved.record
    if isinstance(result, Run) and isinstance(record, RunRecord):
        if (result.outcome.value, result.reason) != (record.outcome, record.message):
            ends = f"'{record.outcome} ({record.message})' differs from the recomputed "
            ends += f"'{result.outcome.value} ({result.reason})'"
            raise InputError(ends, file=saved.file, key="outcome", remedy=REMEDY)
    return result
