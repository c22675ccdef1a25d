"""planopt: motion plans for robots that must stay in radio contact.

Names are imported when they are first used, so that ``import planopt`` costs nothing. The stub
``__init__.pyi`` lists them. Others are in :mod:`planopt.channel` (the radio channel),
:mod:`planopt.objectives` (terms), :mod:`planopt.problems` (ground truth, dynamics, systems) and
:mod:`planopt.extend` (parts of one's own).
"""

from planopt.lazy_names import forward_modules, lazy_names

FORMER_NAMES = {
    "Simulation": "Run",
    "TeamRun": "Run",
    "TeamSolution": "Solution",
    "compare_horizons": "compare",
    "explain_no_plan": "explain",
}
"""Former public names, accepted for one version, and the names that replace them."""

FORMER_MODULES = {
    "planopt.planning.programme.offenders": "planopt.planning.programme.clearance_lines",
    "planopt.planning.proof.apart": "planopt.planning.proof.motion",
    "planopt.planning.rule_result": "planopt.planning.certificate",
    "planopt.planning.team.crew": "planopt.planning.team.team_step",
    "planopt.report.belief_map": "planopt.report.map_figure",
    "planopt.robots.carrot": "planopt.robots.pure_pursuit",
    "planopt.targets.target_model": "planopt.targets.information_filter",
}
"""Modules that had other names formerly, and those that have their names now."""

forward_modules(FORMER_MODULES)

HOMES = ("planopt.channel", "planopt.problems", "planopt.extend", "planopt.objectives")
"""Where public names are that were formerly here; accepted for one version."""

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__, FORMER_NAMES, moved_to=HOMES)
"""Public names of planopt; each is imported from its module when it is first used."""
