"""Scenes of learning and mapping: those of tracking, without a target and without a bound."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from tracking_scene import FIELD_C, Scene, context_in, scene

from planopt.channel import condition
from planopt.extend import Term
from planopt.objectives import LearningTerm, MappingTerm, TermsObjective
from planopt.planning.candidates import Scorer
from planopt.planning.scene import build_ground
from planopt.planning.values.context import Aim, StepContext
from planopt.planning.values.objective_value import ObjectiveValue

Worth = Literal["information", "average", "path", "D", "A"]

WORTHS: tuple[Worth, ...] = ("information", "average", "path", "D", "A")


def term_of(worth: Worth) -> Term:
    """The one term of a problem."""
    if worth in ("D", "A"):
        return LearningTerm(criterion=worth)
    return MappingTerm(worth, 2.0, 0.02)


def information_step(
    worth: Worth, horizon: int, count: int, seed: int, decorrelation_m: float
) -> tuple[Scene, StepContext, Scorer]:
    """A cold step of a seeded scene whose robot knows `count` measurements."""
    place = scene(horizon, count, seed)
    problem = replace(
        place.problem,
        objective=TermsObjective((term_of(worth),)),
        targets=(),
        constraints=replace(place.problem.constraints, p_min=0.0),
    )
    at = np.asarray(problem.robots[0].start_m)
    known = place.belief.posterior
    # What is measured there plays no part in what is worth measuring.
    law = replace(known.parameters, **{**FIELD_C, "decorrelation_m": decorrelation_m})
    belief = replace(place.belief, posterior=condition(law, known.measurements))
    place = replace(place, problem=problem, ground=build_ground(problem, at), belief=belief)
    situation, _ = context_in(place, belief, at, None)
    situation = replace(situation, aim=Aim())
    return place, situation, Scorer(situation, ObjectiveValue(situation))
