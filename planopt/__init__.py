"""planopt: motion plans for robots that must stay in radio contact.

Names are imported when they are first used, so that ``import planopt`` costs nothing. The stub
``__init__.pyi`` lists them. Others are in :mod:`planopt.channel` (the radio channel),
:mod:`planopt.objectives` (terms), :mod:`planopt.problems` (ground truth, dynamics, other tasks) and
:mod:`planopt.extend` (parts of one's own).
"""

from typing import Any

from planopt.lazy_names import lazy_names

_find, __dir__, __all__ = lazy_names(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Return a public name, imported when it is first used, or the version."""
    if name == "__version__":
        from importlib.metadata import version

        return version("planopt")
    return _find(name)
