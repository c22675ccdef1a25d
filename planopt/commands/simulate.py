"""``planopt simulate``: drive the closed loop in the true channel."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING

from planopt.commands.output import (
    NO_PLAN,
    drawing,
    in_columns,
    progress,
    results_folder,
    say,
    show,
    shown_number,
)
from planopt.commands.planning import Asked, driving_command

if TYPE_CHECKING:
    from collections.abc import Sequence

    from planopt.planning.plan import Plan
    from planopt.planning.results import Run


@driving_command
def simulate(asked: Asked) -> int:
    """Drive the closed loop in the ground truth. Exit code 0 verified, 3 not all, 4 not done."""
    from planopt.errors import NoPlanError
    from planopt.planning.files.result_json import no_run_json, run_json
    from planopt.planning.files.saved import PLAN_OR_RUN, RUN_FILE, save_no_plan
    from planopt.planning.loop.closed_loop import simulate as drive

    problem, seed = asked.problem, asked.seed
    with results_folder(asked.out) as folder:
        try:
            with progress("driving, steps:", problem.planner.max_steps) as advance:
                run = drive(
                    problem,
                    seed=seed,
                    on_start=lambda plans: _say_ahead(asked, plans),
                    on_step=lambda _: advance(),
                )
        except NoPlanError as error:
            data = no_run_json(problem, seed, str(error))
            if folder is not None:
                save_no_plan({**data, "plans": []}, problem, folder, RUN_FILE)
            show(asked.json, data, f"{problem.name}: no plan: {error}")
            return NO_PLAN
        if folder is not None:
            run.save(folder)
        show(asked.json, run_json(run), _in_words(run))
        with drawing(folder, PLAN_OR_RUN, wanted=asked.has_pictures) as new:
            if new is not None:
                from planopt.commands.pictures import animate, picture_run

                if problem.report.figures:
                    picture_run(run, new)
                if asked.animation:
                    animate(run, new)
    return run.exit_code


def _say_ahead(asked: Asked, plans: Sequence[Plan]) -> None:
    """Tell of coverage holes on the way before the first step, unless JSON was asked for."""
    from planopt.planning.holes import goal_in_words, holes_in_words
    from planopt.problems.problem import problem_of_robot

    if asked.json or asked.problem.task != "reach":
        return
    problem = asked.problem
    for number, plan in enumerate(plans):
        own = problem_of_robot(problem, number)
        name = f"{problem.name}, {plan.robot}" if len(plans) > 1 else problem.name
        for line in goal_in_words(own, plan.holes) + holes_in_words(
            own, plan.holes, "the way ahead crosses"
        ):
            say(f"{name}: {line}")


def _in_words(run: Run) -> str:
    from planopt.planning.holes import holes_in_words
    from planopt.planning.loop.metrics import run_holes, run_reliability
    from planopt.report import reliability_lines

    problem = run.problem
    planner = problem.planner
    rungs = ", ".join(f"{name} {count}" for name, count in run.rungs.items())
    robots = "1 robot" if len(run.runs) == 1 else f"{len(run.runs)} robots"
    steps = sum(len(one.log.t_s) - 1 for one in run.runs)
    measured = sum(one.metrics.measured_steps for one in run.runs)
    ahead = f", cost to go {problem.cost_to_go}" if problem.cost_to_go is not None else ""
    head = (
        f"{problem.name}: {run.outcome.value} ({run.reason}), horizon {planner.horizon}, "
        f"planner {planner.name}{ahead}, seed {run.seed}"
    )
    if steps == 0:
        return f"{head}\n  {robots}, no step was driven"
    metrics = [
        (name, shown_number(None if isnan(value) else value)) for name, value in run.metrics.items()
    ]
    lines = [
        f"{robots}, {run.verified_rate:.1%} of the steps verified ({rungs or 'none'}), measured at "
        f"{measured} of {steps} steps",
        *in_columns(metrics),
        *_unverified_in_words(run),
    ]
    if problem.task == "reach":
        lines += _costs_in_words(run)
        for one in run.runs:
            crossed = f"{one.robot} crossed" if len(run.runs) > 1 else "crossed"
            lines += holes_in_words(problem, run_holes(one), crossed)
    lines += reliability_lines(run_reliability(run.runs), "steps")
    return "\n".join([head, *(f"  {line}" for line in lines)])


def _unverified_in_words(run: Run) -> list[str]:
    """Return how many plans of each robot are not verified, and why the last of them is not."""
    from planopt.planning.plan import Verdict

    lines: list[str] = []
    for plans in run.plans:
        missing = [plan for plan in plans if plan.verdict is not Verdict.VERIFIED]
        if missing:
            last = missing[-1]
            rule = last.certificate.rule
            why = "" if rule is None else rule.words
            lines.append(
                f"{last.robot}: {len(missing)} of {len(plans)} plans are not verified; the last of "
                f"them: {last.message or why or last.verdict.value}"
            )
    return lines


def _costs_in_words(run: Run) -> list[str]:
    """Return what the run cost against the clairvoyant, and what steps were excused by."""
    from planopt.planning.certificate import excused_in_words, excused_steps

    lines = [
        f"realised cost {shown_number(run.costs['realised_cost_m'], ' m')} at "
        f"objective.outage_price {run.problem.reach.outage_price:g}, of the clairvoyant "
        f"{shown_number(run.costs['clairvoyant_cost_m'], ' m')}"
    ]
    proofs = [plan.certificate for made in run.plans for plan in made]
    excess_m = [proof.excess_m for proof in proofs if proof.excess_m is not None]
    if excess_m:
        lines.append(
            f"{len(excess_m)} of {len(proofs)} plans have steps below p_min, judged by their "
            f"price: they cost at most {max(*excess_m, 0.0):.1f} m more than the cheapest path "
            "that the verifier found"
        )
    return lines + [
        f"{made[0].robot}, {line}" if len(run.plans) > 1 else line
        for made in run.plans
        if made
        for line in excused_in_words(excused_steps([plan.certificate for plan in made]))
    ]
