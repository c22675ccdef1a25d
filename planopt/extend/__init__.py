"""Interfaces for extensions: terms, connectivity rules, dynamics, planners and tasks.

Names are imported when they are first used; the stub ``__init__.pyi`` lists them.
"""

from planopt.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
