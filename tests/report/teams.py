"""Runs of a team in the small world, with chosen numbers: for tests of their pictures."""

from dataclasses import replace
from typing import Any

import numpy as np

from planopt import Robot, Run, Target
from planopt.objectives import LearningTerm, MappingTerm, TermsObjective, TrackingTerm
from planopt.objectives.terms.term import Aim
from planopt.planning.loop.log import ChannelLog, TargetLog

TERMS = {
    "track": TrackingTerm(0.008, 0.08, 1.0),
    "learn": LearningTerm("D"),
    "map": MappingTerm("information", 4.0, 0.02),
}


def team_problem(problem: Any, task: str, robots: int, p_min: float) -> Any:
    target = Target(name="visitor", start_m=(12.0, 12.0), velocity_m_s=(1.0, 0.5))
    return replace(
        problem,
        robots=tuple(
            Robot(name=f"robot_{number}", start_m=(10.0, 10.0 + 6.0 * number), speed_max_m_s=1.0)
            for number in range(robots)
        ),
        objective=TermsObjective((TERMS[task],)),
        constraints=replace(problem.constraints, p_min=p_min),
        targets=(target,) if task == "track" else (),
    )


def team_run(simulation: Any, task: str, robots: int = 3, p_min: float = 0.0) -> Run:
    """The log of the small run for every robot, each 6 m above the last."""
    problem = team_problem(simulation.problem, task, robots, p_min)
    log = simulation.run.log
    count = len(log.t_s)
    shifts = [np.array([0.0, 6.0 * number]) for number in range(robots)]
    runs = tuple(
        replace(
            simulation.run, robot=robot.name, log=replace(log, positions_m=log.positions_m + shift)
        )
        for robot, shift in zip(problem.robots, shifts, strict=True)
    )
    plans = tuple(
        tuple(
            replace(plan, robot=run.robot, positions_m=plan.positions_m + shift)
            for plan in simulation.plans[0]
        )
        for run, shift in zip(runs, shifts, strict=True)
    )
    way = np.stack([12.0 + np.arange(count), 12.0 + 0.5 * np.arange(count)], axis=1)
    target = TargetLog(
        true_m=way,
        station_mean_m=way + 0.3,
        station_variance_m2=2.0 / (1.0 + np.arange(count)),
        station_determinant_m4=1.0 / (1.0 + np.arange(count)) ** 2,
        nees=np.full(count, 2.0),
        nis=np.full((count - 1, robots), 2.0),
        delivered=np.stack([log.connected[1:]] * robots, axis=1),
    )
    return Run(
        problem=problem,
        seed=5,
        truths=simulation.truths,
        runs=runs,
        plans=plans,
        aims=tuple(tuple(Aim(None, None) for _ in released) for released in plans),
        beliefs=(simulation.belief,) * robots,
        first_measurements=simulation.first_measurements,
        target=target if task == "track" else None,
        channel=ChannelLog(
            rms_db=4.0 - 0.1 * np.arange(count),
            anmse_db=-20.0 - np.arange(count),
            theta_variance_db=-5.0 - np.arange(count),
            log_det_m=2.0 - 0.5 * np.arange(count),
            rms_without_multipath_db=3.0 - 0.1 * np.arange(count),
            path_loss_variance_db2=2.0 - 0.2 * np.arange(count),
        ),
    )
