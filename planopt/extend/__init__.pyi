"""Public names for parts of one's own; each is imported from its module when it is first used."""

from planopt.bounds.bound import Bound as Bound
from planopt.files.tables import Column as Column
from planopt.keys import Table as Table
from planopt.objectives.terms.expression import OwnTerm as OwnTerm
from planopt.objectives.terms.expression import casadi_term as casadi_term
from planopt.objectives.terms.term import Term as Term
from planopt.planning.candidates import released as released
from planopt.planning.certificate import BlockedError as BlockedError
from planopt.planning.certificate import BlockedPath as BlockedPath
from planopt.planning.plan import Rung as Rung
from planopt.planning.plan import Termination as Termination
from planopt.planning.proof.rule import OwnRule as OwnRule
from planopt.planning.scene import free_ends as free_ends
from planopt.problems.schema import TaskFile as TaskFile
from planopt.problems.settings import PlannerKind as PlannerKind
from planopt.problems.settings import register_planner as register_planner
from planopt.problems.settings import unregister_planner as unregister_planner
from planopt.robots.casadi_map import CasadiMap as CasadiMap
from planopt.robots.dynamics import Dynamics as Dynamics
from planopt.tasks.task import Task as Task
from planopt.tasks.task import TaskResult as TaskResult
