"""Mutants of the verifier: sources with a small change, and modules made of them."""

import sys
from collections.abc import Callable, Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np


def source_of(module: str) -> str:
    spec = find_spec(module)
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).read_text()


def mutated(module: str, original: str, instead: str) -> str:
    """The text of a module with one place changed."""
    source = source_of(module)
    assert source.count(original) == 1, "the mutant does not fit the source any more"
    return source.replace(original, instead)


def module_of(name: str, source: str, **served: object) -> ModuleType:
    """A module of that text, under a name of its own, served by other ones."""
    module = ModuleType(f"mutant_of_{name.rpartition('.')[2]}")
    # Data classes look their module up.
    sys.modules[module.__name__] = module
    exec(compile(source, "<mutant>", "exec"), module.__dict__)
    module.__dict__.update(served)
    return module


def replaceable(
    mutant: tuple[str, str, str], users: Iterable[ModuleType]
) -> Iterator[tuple[ModuleType, str, Any, Any]]:
    """Every use of a function or class of the module: user, name, original and mutant."""
    changed = module_of(mutant[0], mutated(*mutant))
    for user in users:
        for name, value in list(vars(user).items()):
            if callable(value) and getattr(value, "__module__", None) == mutant[0]:
                yield user, name, value, getattr(changed, name, None)


def all_hold(facts: Iterable[Callable[[], object]]) -> bool:
    try:
        with np.errstate(all="ignore"):
            for fact in facts:
                fact()
    except Exception:
        return False
    return True
