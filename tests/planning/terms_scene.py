"""A small problem whose objective is a sum of terms, and situations in it."""

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from sending_term import SendingTerm

from planopt import Problem
from planopt.channel import Belief
from planopt.extend import casadi_term
from planopt.objectives.terms.term import SteeringPath
from planopt.planning.candidates import Scorer
from planopt.planning.initial_data import prepare
from planopt.planning.proof.rule import VerifierContext, uncertain_law
from planopt.planning.scene import Ground, build_ground
from planopt.planning.values.context import Aim, StepContext, step_context, workspace_region
from planopt.planning.values.objective_value import ObjectiveValue
from planopt.problems.problem import problem_from_tables
from planopt.world import index_obstacles

TRACKING = {
    "kind": "tracking",
    "form": "additive",
    "noise_curvature": 0.008,
    "noise_floor_m2": 0.08,
    "sweet_spot_m": 1,
}
LEARNING = {"kind": "path_loss_learning", "criterion": "D"}
ENERGY = {"kind": "motion_energy", "per_metre_j_m": 0.5, "power_w": 0.1}
CONNECT = {"kind": "until_connected"}


def mapping(form: str) -> dict[str, Any]:
    """A mapping term, with the keys that go with its form."""
    keys = {"variance_threshold_db2": 2.0, "closeness_per_m": 0.02}
    return {"kind": "mapping", "form": form, **(keys if form in ("path", "two_layer") else {})}


SENDING = {"kind": SendingTerm.kind}

TABLES: dict[str, Any] = {
    "problem": {"schema": 1, "name": "small"},
    "world": {
        "bounds_m": [0.0, 0.0, 40.0, 40.0],
        "obstacles": [{"polygon": [[18.0, 12.0], [22.0, 12.0], [22.0, 28.0], [18.0, 28.0]]}],
    },
    "channel": {
        "truth": {
            "kind": "model",
            "k_pl_db": -10.0,
            "n_pl": 2.0,
            "shadow_std_db": 4.0,
            "decorrelation_m": 10.0,
            "multipath_std_db": 1.5,
            "cell_m": 0.5,
        },
        "measurements": {"count": 40, "spacing_m": 0.5},
        "fit": {"method": "reml"},
    },
    "robots": [{"start_m": [10.0, 15.0], "speed_max_m_s": 2.0}],
    "stations": [
        {
            "position_m": [4.0, 4.0],
            "height_m": 2.0,
            "transmit_power_dbm": 0.0,
            "threshold_dbm": -40.0,
        }
    ],
    "constraints": {"clearance_m": 0.5},
    "planner": {"step_s": 1.0, "horizon": 5, "max_steps": 8},
}


FURTHER_STATIONS: list[dict[str, Any]] = [
    {
        "name": "second",
        "position_m": [38.0, 12.0],
        "height_m": 3.0,
        "transmit_power_dbm": 3.0,
        "threshold_dbm": -41.0,
    }
]


def terms_problem(*terms: dict[str, Any], **planner: Any) -> Problem:
    """The small problem with these terms.

    `p_min`, how many `stations`, and the planner's keys may be given.
    """
    tables = copy.deepcopy(TABLES)
    tables["stations"] += FURTHER_STATIONS[: planner.pop("stations", 1) - 1]
    tables["objective"] = {"terms": [dict(term) for term in terms]}
    kinds = {"tracking": "track", "path_loss_learning": "learn", "mapping": "map"}
    kinds["until_connected"] = "connect"
    tables["problem"]["task"] = kinds.get(terms[0]["kind"], "custom")
    if any(term["kind"] == "tracking" for term in terms):
        tables["targets"] = [{"start_m": [14.0, 18.0], "velocity_m_s": [0.9, 0.2]}]
    tables["constraints"]["p_min"] = planner.pop("p_min", 0.0)
    tables["planner"].update(planner)
    return problem_from_tables(tables, folder=Path(), file=None)


def own_term(build: Callable[[Any], Any], steps: int = 5) -> dict[str, Any]:
    """A term of one's own, as in a problem file."""
    term = casadi_term(build, steps)
    return {"kind": "casadi", "steps": term.steps, "program": term.program}


def context_of(problem: Problem, seed: int = 0) -> tuple[StepContext, Belief]:
    """What is known at the start of the problem."""
    belief = prepare(problem, seed).belief
    target = None
    if problem.targets:
        aim = problem.targets[0]
        steps = np.arange(1, problem.planner.horizon + 1)[:, None] * problem.planner.step_s
        target = np.asarray(aim.start_m) + steps * np.asarray(aim.velocity_m_s)
    at = np.asarray(problem.robots[0].start_m)
    region = workspace_region(problem)
    known = np.diag([2.0, 2.0, 8.0, 8.0])
    index = index_obstacles(problem.workspace)
    uncertain = uncertain_law(problem, belief.posteriors)
    base = VerifierContext(problem, index, belief.posteriors, at, uncertain=uncertain)
    turns = np.array([at, [18.0, 30.0], [30.0, 30.0]])
    situation = replace(
        step_context(base, region, Aim(target, information=known)),
        steering=SteeringPath(turns, index, problem.constraints.clearance_m - 1e-6),
    )
    return situation, belief


def scorer_of(situation: StepContext, belief: Belief) -> tuple[Scorer, Ground]:
    """The scorer of a situation, and its ground."""
    problem = situation.problem
    ground = build_ground(problem, situation.position_m)
    context = replace(situation, index=ground.index, posteriors=belief.posteriors)
    scorer = Scorer(context, ObjectiveValue(situation))
    return scorer, ground
