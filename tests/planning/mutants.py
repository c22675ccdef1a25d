"""Sources of the verifier's modules, and modules made of changed sources."""

import sys
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType


def source_of(module: str) -> str:
    """The text of a module."""
    spec = find_spec(module)
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).read_text()


def module_of(name: str, source: str, **served: object) -> ModuleType:
    """A module of that text, under a name of its own, served by other ones."""
    module = ModuleType(f"mutant_of_{name.rpartition('.')[2]}")
    # Data classes look their module up.
    sys.modules[module.__name__] = module
    exec(compile(source, "<mutant>", "exec"), module.__dict__)
    module.__dict__.update(served)
    return module
