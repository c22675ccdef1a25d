"""The task pursuit: pursuers that know evaders by the reports of motes.

The module simulates its problems, compares them with the theorems that apply, and reports the
result as JSON, tables, text and figures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from planopt.errors import NoPlanError
from planopt.files.tables import Column, Data
from planopt.files.typed_json import finite
from planopt.pursuit.certificate import Claim, verify_guarantees
from planopt.pursuit.guarantees import Guarantee
from planopt.pursuit.simulation import Pursuit, PursuitController, simulate_pursuit
from planopt.pursuit.theorems import Distances, Inequality, Theorem
from planopt.pursuit.verify import PursuitData, PursuitLog, Reports, Robot, Service, verify_pursuit
from planopt.tasks.pursuit.tables import PursuitFile, PursuitProblem, build
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
"""Those whose premises the snapshot service keeps."""

RATIO_ROUNDING = 1e-9
"""Share by which a stage may exceed its bound through rounding."""


def simulate(
    problem: PursuitProblem, *, seed: int, on_step: Callable[[], None] = lambda: None
) -> TaskResult:
    """Simulate a pursuit; starts, evaders and lost reports come from the seed."""
    missed = unguaranteed(problem)
    if missed is not None:
        raise NoPlanError(f"capture is not guaranteed: {missed}")
    generator = np.random.default_rng(seed)
    pursuit = simulate_pursuit(problem.scene(generator), generator, on_step)
    given, planner = problem.given, problem.given.planner
    times_s = pursuit.times_s.tolist()
    captures = zip(pursuit.capture_s.tolist(), pursuit.captors.tolist(), strict=True)
    names = [each.name for each in (*given.pursuers, *given.evaders)]
    roles = ["pursuer"] * len(given.pursuers) + ["evader"] * len(given.evaders)
    paths = (*pursuit.pursuers, *pursuit.evaders_m)
    data: dict[str, Any] = {
        "horizon": planner.horizon,
        "planner": planner.name,
        "outcome": pursuit.outcome,
        "reason": _reason(problem, pursuit),
        "capture_time_s": finite(pursuit.capture_time_s),
        "metrics": _metrics(problem, pursuit),
        "rungs": {planner.name: len(times_s) - 1},
        "verified_rate": _verified_rate(problem, pursuit),
        "guarantee": guarantee_json(problem, pursuit),
        "evaders": [
            {
                "name": table.name,
                "captured": bool(np.isfinite(caught_s)),
                "capture_time_s": finite(caught_s),
                "captor": None if captor < 0 else names[captor],
            }
            for table, (caught_s, captor) in zip(given.evaders, captures, strict=True)
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
    return TaskResult(problem, data, tables_of(problem, pursuit), pursuit)


def controller(problem: PursuitProblem, *, seed: int) -> PursuitController:
    """Return the controller of the pursuers, whose starts come from a seed."""
    return PursuitController(problem.scene(np.random.default_rng(seed)))


def unguaranteed(problem: PursuitProblem) -> Inequality | None:
    """Return the first inequality that fails of the theorem that must hold; None if it holds."""
    rules = problem.given.pursuit
    if rules.guarantee is None:
        return None
    for pursuer in range(len(problem.given.pursuers)):
        for evader in range(len(problem.given.evaders)):
            each = problem.guarantees(pursuer, evader)[Theorem(rules.guarantee)]
            for one in (*each.inequalities, each.captures(rules.capture_radius_m)):
                if not one.holds:
                    return one
    return None


def alone(problem: PursuitProblem) -> bool:
    """Return whether there is one pursuer and one evader."""
    return len(problem.given.pursuers) == len(problem.given.evaders) == 1


def in_stages(problem: PursuitProblem) -> bool:
    """Return whether the theorems apply: pursuers drive in stages, to the reported position."""
    return problem.given.planner.name == "drive"


@dataclass(frozen=True, eq=False)
class Stages:
    """The stages of one pursuer after one evader against a theorem."""

    pursuer: int  # Their numbers
    evader: int
    guarantee: Guarantee  # What the theorem says
    bounds_m: NDArray[np.float64]  # (k,) W at the start of each stage

    @property
    def largest_share(self) -> float:
        """Largest W of a stage over what the one before allows; 0 for a single stage."""
        if len(self.bounds_m) < 2:
            return 0.0
        return float((self.bounds_m[1:] / self.guarantee.next_bound_m(self.bounds_m[:-1])).max())

    @property
    def kept(self) -> bool:
        """Return whether every stage is within its bound."""
        return self.largest_share <= 1.0 + RATIO_ROUNDING


def stages(problem: PursuitProblem, pursuit: Pursuit) -> Iterator[Stages]:
    """Yield every chase with every theorem that holds and applies."""
    if not in_stages(problem):
        return
    for pursuer in range(len(pursuit.scene.pursuers)):
        for evader in range(len(pursuit.scene.evaders)):
            found = problem.guarantees(pursuer, evader)
            for theorem in THEOREMS:
                if found[theorem].holds:
                    distances = found[theorem].distances
                    bounds_m = pursuit.bounds_m(pursuer, evader, distances)
                    if len(bounds_m):
                        yield Stages(pursuer, evader, found[theorem], bounds_m)


def guarantee_json(problem: PursuitProblem, pursuit: Pursuit) -> dict[str, Any]:
    """Return what was promised for the first pursuer and evader, and what came of it.

    A time is promised only where there are no others, whom it may have been after before.
    """
    radius_m = problem.given.pursuit.capture_radius_m
    first = pursuit.uses[0] if alone(problem) and pursuit.uses else None
    theorems: dict[str, Any] = {}
    for theorem, each in problem.guarantees(0, 0).items():
        if theorem not in THEOREMS:
            continue
        shares = [
            chase.largest_share
            for chase in stages(problem, pursuit)
            if chase.guarantee.theorem is theorem and len(chase.bounds_m) > 1
        ]
        lasts_s = math.inf
        if first is not None and each.holds:
            first_m = pursuit.away_m(first, each.distances)
            lasts_s = each.capture_time_s(first_m, radius_m)
        theorems[theorem.value] = {
            "distances": each.distances.value,
            "holds": bool(each.holds),
            "inequalities": [_inequality(one) for one in each.inequalities],
            "capture": _inequality(each.captures(radius_m)),
            "ratio": finite(each.ratio),
            "floor_m": finite(each.floor_m),
            "capture_time_s": finite(lasts_s),
            "largest_share_of_bound": max(shares, default=None),
        }
    return {
        "applies": in_stages(problem),
        "detour": problem.arena.detour,
        "theorems": theorems,
    }


def faults(result: TaskResult) -> list[str]:
    """Return what the independent verifier finds in a pursuit and in its guarantee."""
    problem, pursuit = cast("PursuitProblem", result.problem), cast("Pursuit", result.value)
    facts, log, guarantee = facts_of(problem), log_of(pursuit), result.data["guarantee"]
    found = verify_pursuit(facts, log)
    if not found:
        claims = tuple(
            Claim(
                Theorem(name),
                Distances(each["distances"]),
                each["holds"],
                each["capture"]["holds"],
                each["capture_time_s"],
            )
            for name, each in guarantee["theorems"].items()
        )
        found = verify_guarantees(facts, log, claims, guarantee["detour"])
    return [
        f"{RECORDS_FILE if each.kind in ('report', 'order') else STEPS_FILE}: {each.text}"
        for each in found
    ]


def facts_of(problem: PursuitProblem) -> PursuitData:
    """Return what the verifier needs of a problem."""
    given = problem.given
    robots = {"name", "start_m", "start_radius_m", "speed_max_m_s", "turn_rate_max_rad_s"}
    return PursuitData(
        tuple(Robot(**each.model_dump(include=robots)) for each in given.pursuers),
        tuple(Robot(**each.model_dump(include=robots)) for each in given.evaders),
        Service(**given.network.model_dump()),
        given.pursuit.capture_radius_m,
        given.pursuit.step_s,
        given.pursuit.max_steps,
        given.planner.name,
        None if given.world is None else given.world.bounds_m,
        tuple(each.polygon for each in problem.obstacles),
        given.pursuit.clearance_m,
    )


def log_of(pursuit: Pursuit) -> PursuitLog:
    """Return what the verifier needs of a pursuit."""
    uses = pursuit.uses
    reports = Reports(
        np.array([use.pursuer for use in uses], dtype=np.intp),
        np.array([use.evader for use in uses], dtype=np.intp),
        np.array([use.time_s for use in uses]),
        np.array([use.record.sampled_s for use in uses]),
        np.array([use.record.reported_m for use in uses]).reshape(-1, 2),
        np.array([use.record.error_m for use in uses]),
    )
    return PursuitLog(
        pursuit.times_s,
        pursuit.pursuers,
        pursuit.aims_m,
        pursuit.chased,
        pursuit.evaders_m,
        pursuit.capture_s,
        pursuit.captors,
        reports,
    )


def tables_of(problem: PursuitProblem, pursuit: Pursuit) -> dict[str, Data]:
    """Return ``steps.csv`` and ``records.csv``."""
    given, uses = problem.given, pursuit.uses
    pursuers, evaders = ([each.name for each in table] for table in (given.pursuers, given.evaders))
    count, rows = len(pursuers) + len(evaders), len(pursuit.times_s)
    states = (*pursuit.pursuers, *pursuit.evaders_m)
    headings = [s[:, 2] if s.shape[1] > 2 else np.full(rows, np.nan) for s in states]
    chased = np.full((count, rows), -1)
    aims_m = np.full((count, rows, 2), np.nan)
    chased[: len(pursuers), :-1], aims_m[: len(pursuers), :-1] = pursuit.chased, pursuit.aims_m
    records = [use.record for use in uses]
    reported = np.array([each.reported_m for each in records]).reshape(len(uses), 2)
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
            "pursuer": np.array([pursuers[use.pursuer] for use in uses], dtype=np.str_),
            "evader": np.array([evaders[use.evader] for use in uses], dtype=np.str_),
            "t_s": np.array([use.time_s for use in uses]),
            "sampled_s": np.array([each.sampled_s for each in records]),
            "reported_x_m": reported[:, 0],
            "reported_y_m": reported[:, 1],
            "error_m": np.array([each.error_m for each in records]),
        },
    }


def in_words(result: TaskResult) -> Sequence[str]:
    """Return a pursuit in lines of text."""
    data, name = result.data, result.problem.name
    metrics = data["metrics"]
    lines = [
        f"{name}: {data['outcome']} ({data['reason']}), planner {data['planner']}, "
        f"seed {data['seed']}",
        f"  {metrics['steps']} steps, pursuers drove {metrics['pursuer_path_m']:.1f} m, evaders "
        f"{metrics['evader_path_m']:.1f} m",
    ]
    if metrics["records"]:
        lines.append(
            f"  {metrics['records']} records used, on average {metrics['mean_age_s']:.2f} s old "
            f"with an error of {metrics['mean_error_m']:.2f} m"
        )
    guarantee = data["guarantee"]
    if guarantee["detour"] > 1.0:
        lines.append(
            f"  paths are at most {guarantee['detour']:.4g} times as long as straight lines"
        )
    for theorem, each in guarantee["theorems"].items():
        if not guarantee["applies"]:
            lines.append(f"  {theorem}: speaks of driving in stages (planner drive) alone")
            continue
        failing = [one for one in (*each["inequalities"], each["capture"]) if not one["holds"]]
        if failing:
            lines.append(f"  {theorem}: no guarantee, {failing[0]['text']}")
        else:
            lasts_s, share = each["capture_time_s"], each["largest_share_of_bound"]
            promised = "" if lasts_s is None else f" within {lasts_s:.4g} s"
            reached = (
                "no stage but the first"
                if share is None
                else f"stages reached at most {100.0 * share:.1f} % of their bound"
            )
            lines.append(f"  {theorem}: capture guaranteed{promised}; {reached}")
    return lines


def _inequality(inequality: Inequality) -> dict[str, Any]:
    return {
        "text": str(inequality),
        "left": finite(inequality.left),
        "right": finite(inequality.right),
        "unit": inequality.unit,
        "holds": bool(inequality.holds),
    }


def _reason(problem: PursuitProblem, pursuit: Pursuit) -> str:
    if pursuit.outcome == "captured":
        return f"after {pursuit.capture_time_s:.2f} s"
    free = int(np.isinf(pursuit.capture_s).sum())
    places = pursuit.evaders_m[np.isinf(pursuit.capture_s)]
    nearest_m = min(
        float(np.linalg.norm(states[:, :2] - each, axis=1).min())
        for states in pursuit.pursuers
        for each in places
    )
    steps = len(pursuit.times_s) - 1
    knew = "" if pursuit.uses else ", and no record ever came"
    return f"{free} not caught in {steps} steps, nearest {nearest_m:.3g} m{knew}"


def _verified_rate(problem: PursuitProblem, pursuit: Pursuit) -> float | None:
    """Share of the chases, by each theorem that applies, whose stages are all within bounds."""
    kept = [each.kept for each in stages(problem, pursuit)]
    return float(np.mean(kept)) if kept else None


def _metrics(problem: PursuitProblem, pursuit: Pursuit) -> dict[str, Any]:
    errors = [float(np.linalg.norm(use.record.reported_m - use.sampled_m)) for use in pursuit.uses]
    return {
        "capture_time_s": finite(pursuit.capture_time_s),
        "steps": len(pursuit.times_s) - 1,
        "pursuer_path_m": sum(_length_m(states[:, :2]) for states in pursuit.pursuers),
        "evader_path_m": sum(_length_m(places) for places in pursuit.evaders_m),
        "records": len(pursuit.uses),
        "mean_age_s": float(np.mean([use.age_s for use in pursuit.uses])) if errors else None,
        "mean_error_m": float(np.mean(errors)) if errors else None,
    }


def _length_m(places: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def _refusal(problem: PursuitProblem, error: NoPlanError) -> dict[str, Any]:
    """Return the keys of a pursuit that did not begin."""
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
    controller=controller,
    verify=faults,
    reached=("captured",),
    summary=in_words,
    refusal=_refusal,
    columns={STEPS_FILE: STEP_COLUMNS, RECORDS_FILE: RECORD_COLUMNS},
    figures=_figures,
    animate=_animate,
    pictures=(PICTURE,),
    steps=lambda problem: problem.given.pursuit.max_steps,
)
