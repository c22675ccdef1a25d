"""``planopt simulate``: drive the closed loop in the true channel."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planopt.commands.output import NO_PLAN, progress, results_folder, show, shown_number
from planopt.commands.planning import Asked, planning_command
from planopt.commands.team import simulate_asked

if TYPE_CHECKING:
    from planopt.planning.loop.simulation import Simulation


@planning_command
def simulate(asked: Asked) -> int:
    """Drive in the true channel. Exit code 0 all verified, 3 not all, 4 goal not reached."""
    from planopt.errors import NoPlanError
    from planopt.planning.files.run_json import no_run_json, simulation_json
    from planopt.planning.files.saved import RUN_FILE, save_record, save_simulation, withdraw
    from planopt.planning.loop.closed_loop import simulate as drive
    from planopt.planning.loop.simulation import exit_code

    if asked.problem.task != "reach":
        return simulate_asked(asked)
    problem, seed = asked.problem, asked.seed
    with results_folder(asked.out) as folder:
        try:
            with progress("driving, steps:", problem.planner.max_steps) as advance:
                simulation = drive(problem, seed=seed, on_step=lambda _: advance())
        except NoPlanError as error:
            data = no_run_json(problem, seed, str(error))
            if folder is not None:
                withdraw(folder)
                save_record({**data, "plans": []}, problem, folder / RUN_FILE)
            show(asked.json, data, f"{problem.name}: no plan: {error}")
            return NO_PLAN
        if folder is not None:
            withdraw(folder)
            if problem.report.figures:
                from planopt.commands.pictures import picture_simulation

                with progress("drawing"):
                    picture_simulation(simulation, folder)
            save_simulation(simulation, folder)
    show(asked.json, simulation_json(simulation), _in_words(simulation))
    return exit_code(simulation)


def _in_words(simulation: Simulation) -> str:
    from planopt.planning.loop.metrics import run_reliability
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
            *(f"  {line}" for line in reliability_lines(run_reliability([run]), "steps")),
        ]
    )
