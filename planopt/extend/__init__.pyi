"""Public names for parts of one's own; each is imported from its module when it is first used."""

from planopt.files.tables import Column as Column
from planopt.objectives.terms.expression import OwnTerm as OwnTerm
from planopt.objectives.terms.expression import casadi_term as casadi_term
from planopt.objectives.terms.term import Term as Term
from planopt.planning.baselines.baseline import free_ends as free_ends
from planopt.planning.baselines.baseline import released as released
from planopt.planning.holes import BlockedError as BlockedError
from planopt.planning.holes import BlockedWay as BlockedWay
from planopt.planning.plan import Rung as Rung
from planopt.planning.plan import Termination as Termination
from planopt.planning.proof.rules.own import OwnRule as OwnRule
from planopt.problems.planner_kinds import PlannerKind as PlannerKind
from planopt.problems.planner_kinds import register_planner as register_planner
from planopt.problems.planner_kinds import unregister_planner as unregister_planner
from planopt.problems.tables import Table as Table
from planopt.robots.casadi_map import CasadiMap as CasadiMap
from planopt.robots.dynamics import Dynamics as Dynamics
from planopt.tasks.task import Task as Task
from planopt.tasks.task import TaskFile as TaskFile
from planopt.tasks.task import TaskResult as TaskResult
