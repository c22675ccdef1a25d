"""Commands that plan: solve, simulate and check, and the conversion of recorded paths."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Sequence
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from planopt.commands.options import (
    AnimationOption,
    JsonOption,
    PlanningOptions,
    ResultArgument,
    drawing,
    option,
    progress,
    results_folder,
    say,
    show,
    was_interrupted,
    with_options,
)
from planopt.errors import InputError, NoPlanError

if TYPE_CHECKING:
    from planopt.planning.plan import Plan
    from planopt.problems.problem import Problem
    from planopt.tasks.task import Action, Task

ProveOption = Annotated[
    float | None,
    option("--prove", "SECONDS", "Also prove a bound on the objective, within this time."),
]


@with_options(PlanningOptions)
def solve(options: PlanningOptions, prove: ProveOption = None) -> int:
    """Compute one plan from the start. Exit codes: 0 verified, 3 not verified, 4 no plan."""
    return _perform("solve", options, prove_s=prove)


@with_options(PlanningOptions)
def simulate(
    options: PlanningOptions,
    animation: AnimationOption = False,
    live: Annotated[
        bool, option("--live", None, "Show map, plans and powers in the terminal during the run.")
    ] = False,
) -> int:
    """Simulate the closed loop. Exit codes: 0 all verified, 3 not all, 4 the task failed."""
    return _perform("simulate", options, animation, live=live)


def _perform(
    action: Action,
    options: PlanningOptions,
    animation: bool = False,
    prove_s: float | None = None,
    live: bool = False,
) -> int:
    """Solve or simulate the problem, save, print and plot the result, and return the exit code."""
    from planopt.problems.load import load
    from planopt.problems.problem import Problem
    from planopt.problems.tasks import task_of
    from planopt.tasks.task import perform

    if animation and options.out is None:
        raise InputError(
            "needs a folder to save the animation in", key="--animation", remedy="add --out DIR"
        )
    problem = load(options.problem)
    task: Task = task_of(problem)
    if live and not isinstance(problem, Problem):
        raise InputError(
            f"is not available for the task {problem.task}", key="--live", remedy="leave it out"
        )
    if animation and task.animate is None:
        raise InputError(
            f"is not available for the task {problem.task}",
            key="--animation",
            remedy="leave it out",
        )
    problem = task.overridden(
        problem, horizon=options.horizon, planner=options.planner, cost_to_go=options.cost_to_go
    )
    for words in task.warnings(problem):
        say(f"{problem.name}: {words}")

    def say_ahead(plans: Any) -> None:
        for line in task.words_ahead(problem, plans):
            say(line)

    settings: dict[str, Any] = {}
    if prove_s is not None:
        solver = task.function("solve")
        if solver is not None and "prove_s" in signature(solver).parameters:
            settings["prove_s"] = prove_s
        else:
            say(f"{problem.name}: --prove has no effect on the task {problem.task}")
    if action == "simulate" and task.says_ahead and not options.json:
        settings["on_start"] = say_ahead
    report: Any
    total = task.steps(problem) if action == "simulate" else None
    if live:
        settings["on_plans"] = _shown_plans(problem)
    doing = "planning" if action == "solve" else "driving, steps:"
    with results_folder(options.out) as folder:
        try:
            with progress(doing, total, bar=not live) as advance:
                result = perform(
                    action, problem, seed=options.seed, on_step=lambda *_: advance(), **settings
                )
                if prove_s is not None and was_interrupted():
                    say(f"{problem.name}: interrupted; the result has the bounds found so far")
        except NoPlanError as error:
            # The reason is printed at once because finding helpful changes takes longer.
            refusal = f"{problem.name}: no plan: {error}"
            if not options.json:
                show(False, {}, refusal)
            with progress("explaining"):
                report = task.no_plan(action, problem, options.seed, error)
            words = [line for line in report.words if line != refusal]
        else:
            with progress("explaining"):
                report = task.explained(result)
            words = [] if options.json else list(report.words)
        if folder is not None:
            report.save(folder)
        if options.json or words:
            show(options.json, report.data if options.json else {}, "\n".join(words))
        wanted = task.has_figures(problem) or animation
        with drawing(folder, task.files, wanted=wanted) as new:
            if new is not None:
                report.draw(new, animation=animation)
    return report.exit_code


def _shown_plans(problem: Problem) -> Callable[[int, Sequence[Plan]], None]:
    """Return a function that shows the plans of a step on stderr: a map in a terminal, or lines."""
    from planopt.report.motion_words import TerminalMap, step_lines

    if not sys.stderr.isatty():
        return lambda step, plans: say("\n".join(step_lines(problem, step, plans)))
    columns, rows = shutil.get_terminal_size()
    drawn = TerminalMap(problem, columns - 2, rows - 3 - len(problem.robots))
    return lambda step, plans: say(drawn.frame(step, plans), clear=True)


REJECTED = 3


def check(path: ResultArgument, json: JsonOption = False) -> int:
    """Verify saved results from their files alone. Exit codes: 0 accepted, 3 rejected."""
    from planopt.files.tables import encoded
    from planopt.planning.certificate import excused_in_words, excused_steps
    from planopt.planning.files.result_json import certificate_json, no_certificate_json
    from planopt.planning.plan import Verdict
    from planopt.report.motion_words import apart_in_words, planned_in_words
    from planopt.tasks.calls import check as checked

    with progress("checking"):
        result = checked(path)
    certificate = (
        no_certificate_json(result.reasons)
        if result.certificate is None
        else certificate_json(result.certificate)
    )
    planned = planned_in_words(certificate["min_clearance_m"], certificate["min_connectivity"])
    rule = None if result.certificate is None else result.certificate.rule
    excused = excused_steps(result.certificates)
    data = {
        "verdict": result.verdict.value,
        "certificate": certificate,
        "excused": encoded(excused),
        "reasons": list(result.reasons),
        "remarks": list(result.remarks),
    }
    lines = [
        f"{path}: {result.verdict.value}, by a second verification from the saved files",
        *([] if result.certificate is None else [f"  {planned}"]),
        *apart_in_words(certificate["min_separation_m"], certificate["min_moving_clearance_m"]),
        *([] if rule is None else [f"  {rule.words}"]),
        *(f"  {line}" for line in excused_in_words(excused)),
        *(f"  {reason}" for reason in result.reasons),
        *(f"  note: {remark}" for remark in result.remarks),
    ]
    show(json, data, "\n".join(lines))
    return 0 if result.verdict is Verdict.VERIFIED else REJECTED


def export_path(
    result: ResultArgument,
    out: Annotated[
        Path, option("--out", "FILE", "Ends in .json, .geojson, .plan, .csv, .mcap or .rrd.")
    ],
    robot: Annotated[
        str | None, option("--robot", "NAME", "Robot; default: the first one.")
    ] = None,
    origin: Annotated[
        str | None,
        option("--origin", "LAT,LON", "Position of (0, 0) in degrees; default: that of the log."),
    ] = None,
    altitude: Annotated[
        float, option("--altitude", "M", "Altitude above the start, for drones.")
    ] = 0.0,
    json: JsonOption = False,
) -> int:
    """Write the path of a saved plan or run for other programs.

    .json is for ROS, .plan for QGroundControl. .mcap (Foxglove) and .rrd (Rerun) are recordings of
    all robots with their plans, powers and the map.
    """
    from planopt.planning.files.path_files import RECORDERS, path_of_result, save_path
    from planopt.planning.loop.results import Run, Solution
    from planopt.tasks.calls import load_result
    from planopt.world.geodesy import parse_origin

    place = None if origin is None else parse_origin(origin)
    with progress("reading"):
        found = load_result(result)
    if not isinstance(found, Solution | Run):
        raise InputError("is no plan or run of robots", file=result, remedy="name one of a motion")
    if out.suffix.lower() in RECORDERS:
        with progress("writing"):
            found.save_recording(out)
        robots = len(found.problem.robots)
        words = f"{out}: recording of {robots} robot{'' if robots == 1 else 's'}"
        show(json, {"file": str(out), "robots": robots}, words)
        return 0
    path = path_of_result(found, 0 if robot is None else robot)
    save_path(path, out, place, altitude)
    data = {"file": str(out), "robot": path.robot, "positions": len(path.t_s)}
    show(json, data, f"{out}: {len(path.t_s)} positions of {path.robot}")
    return 0


def report(result: ResultArgument, json: JsonOption = False) -> int:
    """Write report.html, a page with map and charts, next to a result."""
    from planopt.files.writing import write_text
    from planopt.report.page import PAGE_FILE, page_html
    from planopt.report.page_content import comparison_page
    from planopt.studies.comparison import Comparison
    from planopt.tasks.calls import load_result

    with progress("reading"):
        found = load_result(result)
    with progress("drawing"):
        if isinstance(found, Comparison):
            page = comparison_page(found)
        else:
            page = found.task.page(found)
        file = (result if result.is_dir() else result.parent) / PAGE_FILE
        write_text(file, page_html(page))
    steps = 0 if page.map is None else len(page.map.times_s) - 1
    data = {"file": str(file), "title": page.title, "steps": steps}
    show(json, data, f"{file}: {page.title}")
    return 0
