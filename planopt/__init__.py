"""planopt: motion planning for robots that must stay in radio contact.

Names are imported on first use, so ``import planopt`` costs nothing. The stub ``__init__.pyi``
lists them. Further names are in :mod:`planopt.channel` (the radio channel),
:mod:`planopt.objectives` (terms), :mod:`planopt.problems` (ground truth, dynamics, other tasks) and
:mod:`planopt.extend` (user-defined parts).
"""

from planopt.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
