"""``planopt simulate``: drive the closed loop in the true channel."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planopt.commands.output import (
    NO_PLAN,
    drawing,
    progress,
    results_folder,
    say,
    show,
    shown_number,
)
from planopt.commands.planning import Asked, driving_command
from planopt.commands.team import simulate_asked

if TYPE_CHECKING:
    from planopt.planning.loop.simulation import Simulation
    from planopt.planning.plan import Plan


@driving_command
def simulate(asked: Asked) -> int:
    """Drive in the true channel. Exit code 0 all verified, 3 not all, 4 goal not reached."""
    from planopt.errors import NoPlanError
    from planopt.planning.files.run_json import no_run_json, simulation_json
    from planopt.planning.files.saved import PLAN_OR_RUN, RUN_FILE, save_no_plan, save_simulation
    from planopt.planning.loop.closed_loop import simulate as drive
    from planopt.planning.loop.simulation import exit_code

    if asked.problem.task != "reach":
        return simulate_asked(asked)
    problem, seed = asked.problem, asked.seed
    with results_folder(asked.out) as folder:
        try:
            with progress("driving, steps:", problem.planner.max_steps) as advance:
                simulation = drive(
                    problem,
                    seed=seed,
                    on_start=lambda plan: _say_ahead(asked, plan),
                    on_step=lambda _: advance(),
                )
        except NoPlanError as error:
            data = no_run_json(problem, seed, str(error))
            if folder is not None:
                save_no_plan({**data, "plans": []}, problem, folder, RUN_FILE)
            show(asked.json, data, f"{problem.name}: no plan: {error}")
            return NO_PLAN
        if folder is not None:
            save_simulation(simulation, folder, pictures_follow=asked.has_pictures)
        show(asked.json, simulation_json(simulation), _in_words(simulation))
        with drawing(folder, PLAN_OR_RUN, wanted=asked.has_pictures) as new:
            if new is not None:
                from planopt.commands.pictures import animate, picture_simulation

                if problem.report.figures:
                    picture_simulation(simulation, new)
                if asked.animation:
                    animate(simulation, new)
    return exit_code(simulation)


def _say_ahead(asked: Asked, plan: Plan) -> None:
    """Tell of coverage holes on the way before the first step, unless JSON was asked for."""
    from planopt.planning.holes import goal_in_words, holes_in_words

    if asked.json:
        return
    problem = asked.problem
    for line in goal_in_words(problem, plan.holes) + holes_in_words(
        problem, plan.holes, "the way ahead crosses"
    ):
        say(f"{problem.name}: {line}")


def _in_words(simulation: Simulation) -> str:
    from planopt.planning.holes import holes_in_words
    from planopt.planning.loop.metrics import run_holes, run_reliability
    from planopt.report.tables import reliability_lines

    run = simulation.run
    metrics = run.metrics
    rungs = ", ".join(f"{name} {count}" for name, count in run.rungs.items())
    return "\n".join(
        [
            f"{simulation.problem.name}: {run.outcome.value} ({run.reason}), "
            f"horizon {run.horizon}, cost to go {run.cost_to_go}, seed {run.seed}",
            f"  {len(run.log.t_s) - 1} steps, {metrics.path_m:.1f} m, "
            f"{run.verified_rate:.1%} of the steps verified ({rungs or 'none'}), measured at "
            f"{metrics.measured_steps}",
            f"  truly connected {metrics.true_connected_share:.1%} of the steps, longest outage "
            f"{metrics.longest_outage_m:.1f} m, least P(connected) of the driven steps "
            f"{shown_number(metrics.predicted_min_connectivity)}",
            *_costs_in_words(simulation),
            *(
                f"  {line}"
                for line in holes_in_words(simulation.problem, run_holes(run), "crossed")
            ),
            *(f"  {line}" for line in reliability_lines(run_reliability([run]), "steps")),
        ]
    )


def _costs_in_words(simulation: Simulation) -> list[str]:
    """What the run cost against the clairvoyant, and what steps were excused by."""
    run, price = simulation.run, simulation.problem.reach.outage_price
    lines = [
        f"  realised cost {shown_number(run.costs['realised_cost_m'], ' m')} at "
        f"objective.outage_price {price:g}, of the clairvoyant "
        f"{shown_number(run.costs['clairvoyant_cost_m'], ' m')}"
    ]
    proofs = [plan.certificate for plan in simulation.plans]
    shares = [
        proof.path_cost_m / proof.best_cost_m - 1.0
        for proof in proofs
        if proof.path_cost_m and proof.best_cost_m
    ]
    if shares:
        lines.append(
            f"  {len(shares)} of {len(proofs)} plans have steps below p_min, excused by their "
            f"price: they cost at most {100.0 * max(*shares, 0.0):.1f} % more than the cheapest "
            "path that the verifier found"
        )
    return lines
