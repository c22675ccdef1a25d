"""Sensor networks that cover a region, respond to events, and estimate their own number of agents.

The modules take arrays and frozen dataclasses; no problem file is needed. Names are imported when
they are first used; the stub ``__init__.pyi`` lists them.
"""

from planopt.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
