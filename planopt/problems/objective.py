"""Every class that an objective is made of."""

from __future__ import annotations

from planopt.objectives.terms.expression import CasadiTerm
from planopt.objectives.terms.goal import GoalTerm
from planopt.objectives.terms.learning import LearningCriterion, LearningTerm
from planopt.objectives.terms.mapping import MappingForm, MappingTerm
from planopt.objectives.terms.motion_energy import MotionEnergyTerm
from planopt.objectives.terms.term import Term
from planopt.objectives.terms.tracking import TrackingForm, TrackingTerm
from planopt.objectives.terms.until_connected import UntilConnectedTerm
from planopt.problems.problem import CostToGo, ReachObjective, TermsObjective

__all__ = [
    "CasadiTerm",
    "CostToGo",
    "GoalTerm",
    "LearningCriterion",
    "LearningTerm",
    "MappingForm",
    "MappingTerm",
    "MotionEnergyTerm",
    "ReachObjective",
    "Term",
    "TermsObjective",
    "TrackingForm",
    "TrackingTerm",
    "UntilConnectedTerm",
]
