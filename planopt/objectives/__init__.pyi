"""Public names of the objectives; each is imported from its module when it is first used."""

from planopt.objectives.terms.distance import GoalTerm as GoalTerm
from planopt.objectives.terms.distance import MotionEnergyTerm as MotionEnergyTerm
from planopt.objectives.terms.expression import CasadiTerm as CasadiTerm
from planopt.objectives.terms.measured import LearningTerm as LearningTerm
from planopt.objectives.terms.measured import MappingTerm as MappingTerm
from planopt.objectives.terms.tracking import TrackingTerm as TrackingTerm
from planopt.objectives.terms.until_connected import UntilConnectedTerm as UntilConnectedTerm
from planopt.problems.objective import ReachObjective as ReachObjective
from planopt.problems.objective import TermsObjective as TermsObjective
