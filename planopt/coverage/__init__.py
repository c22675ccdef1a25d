"""Sensor networks that cover a region, respond to events, and estimate their number of agents."""

from planopt.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
