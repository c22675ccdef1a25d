"""planopt: motion plans for robots that must stay in radio contact.

Names are imported when they are first used, so that ``import planopt`` costs nothing. The stub
``__init__.pyi`` lists them; those of the radio channel are in :mod:`planopt.channel`.
"""

from planopt.lazy_names import lazy_names

FORMER_NAMES = {
    "Simulation": "Run",
    "TeamRun": "Run",
    "TeamSolution": "Solution",
    "casadi_term": "planopt.objectives.casadi_term",
}
"""Former public names, accepted for one version, and the names that replace them."""

__getattr__, __dir__, __all__ = lazy_names(
    __name__, __file__, FORMER_NAMES, moved_to="planopt.channel"
)
