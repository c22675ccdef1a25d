"""Public names of planopt; each is imported from its module when it is first used."""

from planopt import channel as channel
from planopt.channel.belief import Belief as Belief
from planopt.channel.estimation.fit import fit_channel as fit_channel
from planopt.channel.logs.log_file import read_log as read_log
from planopt.channel.maps.posterior_map import posterior_map as posterior_map
from planopt.channel.measurements import Measurements as Measurements
from planopt.errors import InputError as InputError
from planopt.errors import NoPlanError as NoPlanError
from planopt.errors import OutputError as OutputError
from planopt.errors import PlanoptError as PlanoptError
from planopt.planning.check.check import check as check
from planopt.planning.explain.explain import explain as explain
from planopt.planning.explain.explain import explain_no_plan as explain_no_plan
from planopt.planning.loop.closed_loop import simulate as simulate
from planopt.planning.plan import Termination as Termination
from planopt.planning.plan import Verdict as Verdict
from planopt.planning.run import Run as Run
from planopt.planning.solution import Solution as Solution
from planopt.planning.solve import solve as solve
from planopt.problems.casadi_term import casadi_term as casadi_term
from planopt.problems.library import list_problems as list_problems
from planopt.problems.load import load as load
from planopt.problems.problem import Problem as Problem
from planopt.problems.systems import SystemProblem as SystemProblem
from planopt.problems.systems import load_system as load_system
from planopt.studies.compare import compare_horizons as compare_horizons
