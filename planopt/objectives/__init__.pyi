"""Public names of the objectives; each is imported from its module when it is first used."""

from planopt.problems.objective import CasadiTerm as CasadiTerm
from planopt.problems.objective import GoalTerm as GoalTerm
from planopt.problems.objective import LearningTerm as LearningTerm
from planopt.problems.objective import MappingTerm as MappingTerm
from planopt.problems.objective import MotionEnergyTerm as MotionEnergyTerm
from planopt.problems.objective import ReachObjective as ReachObjective
from planopt.problems.objective import TermsObjective as TermsObjective
from planopt.problems.objective import TrackingTerm as TrackingTerm
from planopt.problems.objective import UntilConnectedTerm as UntilConnectedTerm
