"""Import a package's public names when they are first used.

The stub ``__init__.pyi`` beside a package's ``__init__.py`` lists its public names, each once, as
``from module import Name as Name``; packages within it are listed like names. Type checkers read
the stub, and so does :func:`lazy_names`.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any
from warnings import warn


def lazy_names(
    package: str,
    file: str,
    former: Mapping[str, str] | None = None,
    moved_to: Sequence[str] = (),
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package with lazy public names.

    Parameters
    ----------
    package, file
        ``__name__`` and ``__file__`` of the package.
    former
        Former public names, accepted with a warning, and the names that replace them.
    moved_to
        Packages that have public names which `package` had formerly; accepted with a warning.
    """
    modules = _listed_names(f"{file}i")

    def find(name: str) -> Any:
        if modules.get(name) == package:
            return import_module(f"{package}.{name}")
        if name in modules:
            return getattr(import_module(modules[name]), name)
        new = _replacement(package, name, former or {}, moved_to)
        if new is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home, _, current = new.rpartition(".")
        warn(f"{package}.{name} is now {new}", DeprecationWarning, stacklevel=2)
        return getattr(import_module(home), current)

    def names() -> list[str]:
        return sorted({*vars(import_module(package)), *modules})

    return find, names, sorted(modules)


def _listed_names(stub: str) -> dict[str, str]:
    """Return the public names in a package's stub, each with the module that has it."""
    with open(stub, encoding="utf-8") as file:
        tree = ast.parse(file.read())
    return {
        alias.name: statement.module
        for statement in tree.body
        if isinstance(statement, ast.ImportFrom) and statement.module is not None
        for alias in statement.names
    }


def _replacement(
    package: str, name: str, former: Mapping[str, str], moved_to: Sequence[str]
) -> str | None:
    """Return the full name that replaces a former one; None if it never was a name."""
    if name in former:
        return f"{package}.{former[name]}"
    # Python and its tools ask any module for names with underscores.
    if name.startswith("_"):
        return None
    homes = (home for home in moved_to if name in import_module(home).__all__)
    return next((f"{home}.{name}" for home in homes), None)
