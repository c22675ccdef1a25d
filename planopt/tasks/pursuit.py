"""Task pursuit: pursuers observe evaders through the reports of a mote network."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from planopt.arrays import Floats
from planopt.errors import NoPlanError
from planopt.files.tables import Column, Data, finite
from planopt.pursuit.certificate import Claim, Distances, Inequality, Theorem, verify_guarantees
from planopt.pursuit.simulation import Pursuit, PursuitController, simulate_pursuit
from planopt.pursuit.verify import PursuitData, PursuitLog, Reports, Robot, Service, verify_pursuit
from planopt.tasks.pursuit_tables import PursuitFile, PursuitProblem, build
from planopt.tasks.task import Task, TaskResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEPS_FILE, RECORDS_FILE = "steps.csv", "records.csv"
PICTURE = "run.png"

STEP_COLUMNS = (
    Column("robot", "name of the pursuer or evader", kind="text", required=True),
    Column("step", "number of the step; 0 is the start", kind="count", required=True),
    Column("t_s", "time", "s", required=True),
    Column("x_m", "position", "m", required=True),
    Column("y_m", "position", "m", required=True),
    Column("heading_rad", "heading of a pursuer that must turn", "rad"),
    Column("chases", "evader that a pursuer chases in the step that begins here", kind="text"),
    Column("aim_x_m", "aim of a pursuer in that step", "m"),
    Column("aim_y_m", "aim of a pursuer in that step", "m"),
)
RECORD_COLUMNS = (
    Column("pursuer", "pursuer that received the report", kind="text", required=True),
    Column("evader", "evader that the report is about", kind="text", required=True),
    Column("t_s", "time of the report", "s", required=True),
    Column("sampled_s", "time when the evader was sensed", "s", required=True),
    Column("reported_x_m", "reported position", "m", required=True),
    Column("reported_y_m", "reported position", "m", required=True),
    Column("error_m", "bound on the error of the reported position", "m", required=True),
)

THEOREMS = (Theorem.ANY_INSTANT, Theorem.SNAPSHOTS)
"""Theorems whose premises the snapshot service satisfies."""
RATIO_ROUNDING = 1e-9
"""Relative rounding tolerance for the ratio of a stage's distance bound to its limit."""


def simulate(
    problem: PursuitProblem, *, seed: int, on_step: Callable[[], None] = lambda: None
) -> TaskResult:
    """Simulate a pursuit; the seed determines starts, evaders and lost reports."""
    missed = _missed_guarantee(problem)
    if missed is not None:
        raise NoPlanError(f"capture is not guaranteed: {missed}")
    generator = np.random.default_rng(seed)
    pursuit = simulate_pursuit(problem.scene(generator), generator, on_step)
    shares = list(_stage_shares(problem, pursuit))
    config, planner = problem.config, problem.config.planner
    times_s = pursuit.times_s.tolist()
    captures = zip(pursuit.capture_s.tolist(), pursuit.captors.tolist(), strict=True)
    names = [each.name for each in (*config.pursuers, *config.evaders)]
    roles = ["pursuer"] * len(config.pursuers) + ["evader"] * len(config.evaders)
    paths = (*pursuit.pursuers, *pursuit.evaders_m)
    kept = [share <= 1.0 + RATIO_ROUNDING for _, share in shares]
    data: dict[str, Any] = {
        "horizon": planner.horizon,
        "planner": planner.name,
        "outcome": pursuit.outcome,
        "reason": _reason(pursuit),
        "capture_time_s": finite(pursuit.capture_time_s),
        "metrics": _metrics(problem, pursuit),
        "rungs": {planner.name: len(times_s) - 1},
        "verified_rate": float(np.mean(kept)) if kept else None,
        "guarantee": _guarantee_json(problem, pursuit, shares),
        "evaders": [
            {
                "name": table.name,
                "captured": bool(np.isfinite(caught_s)),
                "capture_time_s": finite(caught_s),
                "captor": None if captor < 0 else names[captor],
            }
            for table, (caught_s, captor) in zip(config.evaders, captures, strict=True)
        ],
        "robots": [
            {
                "name": name,
                "role": role,
                "t_s": times_s,
                "x_m": states[:, 0].tolist(),
                "y_m": states[:, 1].tolist(),
            }
            for name, role, states in zip(names, roles, paths, strict=True)
        ],
    }
    return TaskResult(problem, data, _tables(problem, pursuit), pursuit)


def _controller(problem: PursuitProblem, *, seed: int) -> PursuitController:
    """Return the controller of the pursuers; `seed` determines their start positions."""
    return PursuitController(problem.scene(np.random.default_rng(seed)))


def _missed_guarantee(problem: PursuitProblem) -> Inequality | None:
    """Return the first violated inequality of the required theorem; None if all hold."""
    rules = problem.config.pursuit
    if rules.guarantee is None:
        return None
    for pursuer in range(len(problem.config.pursuers)):
        for evader in range(len(problem.config.evaders)):
            each = problem.guarantees(pursuer, evader)[Theorem(rules.guarantee)]
            for one in (*each.inequalities, each.captures(rules.capture_radius_m)):
                if not one.holds:
                    return one
    return None


def _stage_shares(problem: PursuitProblem, pursuit: Pursuit) -> Iterator[tuple[Theorem, float]]:
    """Yield each theorem with the largest ratio of a stage's distance bound to its limit."""
    if problem.config.planner.name != "drive":
        return
    for pursuer in range(len(pursuit.scene.pursuers)):
        for evader in range(len(pursuit.scene.evaders)):
            found = problem.guarantees(pursuer, evader)
            for each in (found[theorem] for theorem in THEOREMS if found[theorem].holds):
                bounds_m = pursuit.bounds_m(pursuer, evader, each.distances)
                if len(bounds_m):
                    allowed_m = each.next_bound_m(bounds_m[:-1])
                    yield each.theorem, float((bounds_m[1:] / allowed_m).max(initial=0.0))


def _guarantee_json(
    problem: PursuitProblem, pursuit: Pursuit, shares: Sequence[tuple[Theorem, float]]
) -> dict[str, Any]:
    """Return JSON data of the first pursuer's guarantee, with the largest shares of its bounds."""
    radius_m, uses = problem.config.pursuit.capture_radius_m, pursuit.uses
    alone = len(problem.config.pursuers) == len(problem.config.evaders) == 1
    theorems: dict[str, Any] = {}
    for theorem, each in problem.guarantees(0, 0).items():
        if theorem not in THEOREMS:
            continue
        lasts_s = math.inf
        if alone and uses and each.holds:
            lasts_s = each.capture_time_s(pursuit.away_m(uses[0], each.distances), radius_m)
        largest = max((share for one, share in shares if one is theorem), default=0.0)
        theorems[theorem.value] = {
            "distances": each.distances.value,
            "holds": bool(each.holds),
            "inequalities": [_inequality(one) for one in each.inequalities],
            "capture": _inequality(each.captures(radius_m)),
            "ratio": finite(each.ratio),
            "floor_m": finite(each.floor_m),
            "capture_time_s": finite(lasts_s),
            "largest_share_of_bound": largest or None,
        }
    return {
        "applies": problem.config.planner.name == "drive",
        "detour": problem.arena.detour,
        "theorems": theorems,
    }


def _inequality(inequality: Inequality) -> dict[str, Any]:
    return {
        "text": str(inequality),
        "left": finite(inequality.left),
        "right": finite(inequality.right),
        "unit": inequality.unit,
        "holds": bool(inequality.holds),
    }


def _faults(result: TaskResult) -> list[str]:
    """Return the violations found by the independent verifier."""
    data, log = verifier_data(result)
    guarantee = result.data["guarantee"]
    found = verify_pursuit(data, log)
    if not found:
        found = verify_guarantees(data, log, claims(result), guarantee["detour"])
    return [
        f"{RECORDS_FILE if each.kind in ('report', 'order') else STEPS_FILE}: {each.text}"
        for each in found
    ]


def claims(result: TaskResult) -> tuple[Claim, ...]:
    """Return the guarantees of a result as claims for the verifier to check."""
    return tuple(
        Claim(
            Theorem(name),
            Distances(each["distances"]),
            each["holds"],
            each["capture"]["holds"],
            each["capture_time_s"],
        )
        for name, each in result.data["guarantee"]["theorems"].items()
    )


def verifier_data(result: TaskResult) -> tuple[PursuitData, PursuitLog]:
    """Return the problem and the log of a simulated result for the verifier."""
    problem, pursuit = cast("PursuitProblem", result.problem), cast("Pursuit", result.value)
    config = problem.config
    keys = {"name", "start_m", "start_radius_m", "speed_max_m_s", "turn_rate_max_rad_s"}
    data = PursuitData(
        tuple(Robot(**each.model_dump(include=keys)) for each in config.pursuers),
        tuple(Robot(**each.model_dump(include=keys)) for each in config.evaders),
        Service(**config.network.model_dump()),
        config.pursuit.capture_radius_m,
        config.pursuit.step_s,
        config.pursuit.max_steps,
        config.planner.name,
        None if config.world is None else config.world.bounds_m,
        tuple(each.polygon for each in problem.obstacles),
        config.pursuit.clearance_m,
    )
    return data, PursuitLog(
        pursuit.times_s,
        pursuit.pursuers,
        pursuit.aims_m,
        pursuit.chased,
        pursuit.evaders_m,
        pursuit.capture_s,
        pursuit.captors,
        _reports(pursuit),
    )


def _reports(pursuit: Pursuit) -> Reports:
    """Return the reports that the pursuers used."""
    uses = pursuit.uses
    return Reports(
        np.array([use.pursuer for use in uses], dtype=np.intp),
        np.array([use.evader for use in uses], dtype=np.intp),
        np.array([use.time_s for use in uses]),
        np.array([use.record.sampled_s for use in uses]),
        np.array([use.record.reported_m for use in uses]).reshape(-1, 2),
        np.array([use.record.error_m for use in uses]),
    )


def _tables(problem: PursuitProblem, pursuit: Pursuit) -> dict[str, Data]:
    """Return the tables ``steps.csv`` and ``records.csv``."""
    config, reports = problem.config, _reports(pursuit)
    pursuers, evaders = ([one.name for one in table] for table in (config.pursuers, config.evaders))
    count, rows = len(pursuers) + len(evaders), len(pursuit.times_s)
    states = (*pursuit.pursuers, *pursuit.evaders_m)
    headings = [s[:, 2] if s.shape[1] > 2 else np.full(rows, np.nan) for s in states]
    chased = np.full((count, rows), -1)
    aims_m = np.full((count, rows, 2), np.nan)
    chased[: len(pursuers), :-1], aims_m[: len(pursuers), :-1] = pursuit.chased, pursuit.aims_m
    return {
        STEPS_FILE: {
            "robot": np.repeat([*pursuers, *evaders], rows),
            "step": np.tile(np.arange(rows), count),
            "t_s": np.tile(pursuit.times_s, count),
            "x_m": np.concatenate([each[:, 0] for each in states]),
            "y_m": np.concatenate([each[:, 1] for each in states]),
            "heading_rad": np.concatenate(headings),
            "chases": np.array([*evaders, ""])[chased.ravel()],
            "aim_x_m": aims_m[..., 0].ravel(),
            "aim_y_m": aims_m[..., 1].ravel(),
        },
        RECORDS_FILE: {
            "pursuer": np.array(pursuers)[reports.pursuer],
            "evader": np.array(evaders)[reports.evader],
            "t_s": reports.time_s,
            "sampled_s": reports.sampled_s,
            "reported_x_m": reports.reported_m[:, 0],
            "reported_y_m": reports.reported_m[:, 1],
            "error_m": reports.error_m,
        },
    }


THEOREM_WORDS = {
    "any_instant": "uses bounds on age and error of the reports",
    "snapshots": "also uses the schedule of the reports",
}
"""Data that each theorem uses, in text."""


def _in_words(result: TaskResult) -> Sequence[str]:
    """Return a text summary of a pursuit, line by line."""
    data, name = result.data, result.problem.name
    metrics, guarantee = data["metrics"], data["guarantee"]
    lines = [
        f"{name}: {data['outcome']} ({data['reason']}), planner {data['planner']}, "
        f"random seed {data['seed']}",
        f"  {metrics['steps']} steps; driven length: pursuers {metrics['pursuer_path_m']:.1f} m, "
        f"evaders {metrics['evader_path_m']:.1f} m",
    ]
    if metrics["records"]:
        lines.append(
            f"  position reports used: {metrics['records']}, mean age {metrics['mean_age_s']:.2f} "
            f"s, mean error {metrics['mean_error_m']:.2f} m"
        )
    lines.append(
        f"  blocks sent by motes to report evaders: {metrics['report_blocks']}; reports used that "
        f"were false alarms or of another evader: {metrics['wrong_records']}"
    )
    if guarantee["detour"] > 1.0:
        lines.append(
            f"  paths are at most {guarantee['detour']:.4g} times as long as straight lines"
        )
    for theorem, each in guarantee["theorems"].items():
        failing = [one for one in (*each["inequalities"], each["capture"]) if not one["holds"]]
        lasts_s, share = each["capture_time_s"], each["largest_share_of_bound"]
        if not guarantee["applies"]:
            words = "no guarantee, as it applies only to the planner drive"
        elif failing:
            words = f"no guarantee, as a premise fails: {failing[0]['text']}"
        else:
            within = "" if lasts_s is None else f" within {lasts_s:.4g} s"
            reached = (
                "one report was enough, so the bound on later reports was not tested"
                if share is None
                else f"the distance reached at most {100.0 * share:.1f} % of its bound"
            )
            words = f"capture guaranteed{within}; {reached}"
        lines.append(f"  theorem '{theorem}' ({THEOREM_WORDS[theorem]}): {words}")
    return lines


def _reason(pursuit: Pursuit) -> str:
    if pursuit.outcome == "captured":
        return f"after {pursuit.capture_time_s:.2f} s"
    free = pursuit.evaders_m[np.isinf(pursuit.capture_s)]
    nearest_m = min(
        float(np.linalg.norm(states[:, :2] - each, axis=1).min())
        for states in pursuit.pursuers
        for each in free
    )
    steps = len(pursuit.times_s) - 1
    unknown = "" if pursuit.uses else ", and no record ever came"
    return f"{len(free)} not caught in {steps} steps, nearest {nearest_m:.3g} m{unknown}"


def _metrics(problem: PursuitProblem, pursuit: Pursuit) -> dict[str, Any]:
    uses, network = pursuit.uses, problem.config.network
    errors_m = [float(np.linalg.norm(use.record.reported_m - use.sampled_m)) for use in uses]
    return {
        "capture_time_s": finite(pursuit.capture_time_s),
        "steps": len(pursuit.times_s) - 1,
        "pursuer_path_m": sum(_length_m(states[:, :2]) for states in pursuit.pursuers),
        "evader_path_m": sum(_length_m(places) for places in pursuit.evaders_m),
        "report_blocks": pursuit.blocks(problem.service, network.updates),
        "records": len(uses),
        "mean_age_s": float(np.mean([use.age_s for use in uses])) if uses else None,
        "mean_error_m": float(np.mean(errors_m)) if uses else None,
        "wrong_records": sum(
            error_m > use.record.error_m * (1.0 + RATIO_ROUNDING)
            for use, error_m in zip(uses, errors_m, strict=True)
        ),
    }


def _length_m(places: Floats) -> float:
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def _refusal(problem: PursuitProblem, error: NoPlanError) -> dict[str, Any]:
    """Return the JSON keys for a pursuit that was not started."""
    nothing = dict.fromkeys(("capture_time_s", "guarantee", "verified_rate", "step_s"))
    empty: dict[str, Any] = {"metrics": {}, "rungs": {}, "evaders": [], "robots": []}
    return {"reason": str(error), **nothing, **empty}


def _figures(result: TaskResult) -> dict[str, Figure]:
    from planopt.report import draw_pursuit

    return {PICTURE: draw_pursuit(result.problem.name, result.value)}


def _animate(result: TaskResult, path: Path) -> None:
    from planopt.report import animate_pursuit

    animate_pursuit(result.problem.name, result.value, path)


TASK = Task(
    model=PursuitFile,
    build=build,
    simulate=simulate,
    override=PursuitProblem.with_planner,
    controller=_controller,
    verify=_faults,
    reached=("captured",),
    criterion=("capture_time_s", "min"),
    summary=_in_words,
    refusal=_refusal,
    columns={STEPS_FILE: STEP_COLUMNS, RECORDS_FILE: RECORD_COLUMNS},
    figures=_figures,
    animate=_animate,
    pictures=(PICTURE,),
    steps=lambda problem: problem.config.pursuit.max_steps,
)
