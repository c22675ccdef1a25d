"""Import of a package's public names on first use, as listed by its stub ``__init__.pyi``."""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from types import FrameType
from typing import Any

LIKE = 0.75  # Minimum similarity at which a known name is suggested for an unknown one


def lazy_names(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package with lazy public names."""
    modules = _listed_names(f"{file}i")

    def find(name: str) -> Any:
        if modules.get(name) == package:
            return import_module(f"{package}.{name}")
        if name in modules:
            return getattr(import_module(modules[name]), name)
        if name == "__version__" and "." not in package:
            from importlib.metadata import version

            return version(package)
        words = f"module {package!r} has no attribute {name!r}{_hint(package, name)}"
        caller = sys._getframe(1)  # pyright: ignore[reportPrivateUsage]
        # Python replaces an AttributeError of "from package import name" by its own message.
        raise (ImportError if _is_import(caller) else AttributeError)(words)

    def names() -> list[str]:
        special = (name for name in vars(import_module(package)) if name.startswith("__"))
        return sorted({*special, *modules})

    return find, names, sorted(modules)


def _listed_names(stub: str) -> dict[str, str]:
    """Return the public names in a package's stub, each with the module that defines it."""
    with open(stub, encoding="utf-8") as file:
        tree = ast.parse(file.read())
    return {
        alias.name: statement.module
        for statement in tree.body
        if isinstance(statement, ast.ImportFrom) and statement.module is not None
        for alias in statement.names
    }


def _is_import(frame: FrameType) -> bool:
    """Return whether a stack frame executes ``from package import name``."""
    import opcode  # Only errors need it, so imports stay fast

    return opcode.opname[frame.f_code.co_code[frame.f_lasti]] == "IMPORT_FROM"


def _hint(package: str, name: str) -> str:
    """Return a hint for a message: the location of a name, or the most similar name."""
    if name.startswith("_"):
        return ""
    import difflib

    root = package.partition(".")[0]
    homes = {home: import_module(home).__file__ for home in (package, root)}
    for listed, module in _listed_names(f"{homes[root]}i").items():
        if module == root:
            homes[f"{root}.{listed}"] = import_module(f"{root}.{listed}").__file__
    known = {home: list(_listed_names(f"{file}i")) for home, file in homes.items()}
    for home, names in known.items():
        if name in names:
            return f": it is {home}.{name}"
    for home, names in known.items():
        close = difflib.get_close_matches(name, names, n=1, cutoff=LIKE)
        if close:
            return f": did you mean {home}.{close[0]}?"
    return f": see dir({package})"
