"""Problems: their files, the library, and parts such as ground truth, dynamics and tasks.

Names are imported lazily on first use; the stub ``__init__.pyi`` lists them.
"""

from planopt.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
