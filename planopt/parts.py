"""Parts of a problem: checks and conversion of user values, registries, errors in own parts."""

from __future__ import annotations

import re
import sys
import traceback
from collections.abc import Collection, Generator, Iterable, Mapping
from contextlib import contextmanager
from dataclasses import fields
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError, PlanoptError, listed

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    import numpy as np
    from numpy.typing import NDArray

Part = TypeVar("Part")


def part_of(key: str, value: object, kind: type[Part], remedy: str | None = None) -> Part:
    """Return `value` if it has the required type; raise an InputError otherwise."""
    if not isinstance(value, kind):
        words = f"give {kind.__name__}(...)" if remedy is None else remedy
        got = (
            f"the class {value.__name__}"
            if isinstance(value, type)
            else f"of type {type(value).__name__}"
        )
        raise InputError(f"is {got}", key=key, remedy=words)
    return value


def parts_of(
    key: str, values: object, kind: type[Part], remedy: str | None = None
) -> tuple[Part, ...]:
    """Return one or several values of the required type as a tuple; see :func:`part_of`."""
    if isinstance(values, kind):
        return (values,)
    if not isinstance(values, Iterable) or isinstance(values, str | Mapping):
        return (part_of(key, cast("object", values), kind, remedy),)
    return tuple(
        part_of(f"{key}[{number}]", value, kind, remedy)
        for number, value in enumerate(cast("Iterable[object]", values))
    )


def require_name(name: object, of: str, taken: Collection[str] = (), *, key: str = "kind") -> str:
    """Return `name` if a part may be registered under it, else raise an InputError."""
    is_word = isinstance(name, str) and re.fullmatch(r"[A-Za-z0-9_-]{1,100}", name)
    if not is_word or name in taken:
        others = f"; the names {listed(taken)} are taken" if taken else ""
        raise InputError(
            f"is {name!r}, which cannot be the name of {of}",
            key=key,
            remedy=f"use letters, digits, _ and -{others}",
        )
    return str(name)


class Registry:
    """Registry of parts by name: built-in, registered in this process, or from packages."""

    def __init__(self, of: str, key: str, own: Mapping[str, Any], group: str = "") -> None:
        self.of, self.key, self.group = of, key, group
        self.own = own  # Parts by name, or "module:attribute", imported on first use
        self.registered: dict[str, Any] = {}  # Parts registered in this process

    @cached_property
    def installed(self) -> Mapping[str, EntryPoint]:
        """Return the entry points of packages by name; they are not imported yet."""
        from importlib.metadata import entry_points  # only some commands need it

        return {point.name: point for point in entry_points(group=self.group)} if self.group else {}

    def names(self) -> tuple[str, ...]:
        """Return the names of all parts, the built-in ones first."""
        return tuple(dict.fromkeys([*self.own, *self.registered, *self.installed]))

    def add(self, name: object, part: Any, key: str = "kind") -> None:
        """Register a part in this process; it replaces an earlier one of the same name."""
        self.registered[require_name(name, self.of, self.own, key=key)] = part

    def find(self, name: object) -> Any:
        """Return the part registered under `name`, after importing it if necessary."""
        if not isinstance(name, str) or name not in self.names():
            remedy = f"use one of {', '.join(self.names())}"
            raise InputError(f"is {name!r}", key=self.key, remedy=remedy)
        found = self.own.get(name) or self.registered.get(name)
        if isinstance(found, str):
            module, _, attribute = found.partition(":")
            return getattr(import_module(module), attribute)
        if found is not None:
            return found
        try:
            return self.installed[name].load()
        except (ImportError, AttributeError) as error:
            raise InputError(
                f'is "{name}", whose package cannot be imported ({error})',
                key=self.key,
                remedy="install the packages that it needs, or choose another",
            ) from None


def class_name(part: object) -> str:
    """Return the qualified name of a part's class, or of the part if it is a class or function."""
    named = part if hasattr(part, "__qualname__") else type(part)
    return f"{named.__module__}.{named.__qualname__}"  # pyright: ignore


def is_own(part: object) -> bool:
    """Return whether a part's class is defined outside planopt."""
    return not class_name(part).startswith("planopt.")


@contextmanager
def calling(
    part: object, method: str, *, key: str | None = None, remedy: str | None = None
) -> Generator[None]:
    """Convert an exception in a user-defined part to an InputError with class, method and line."""
    try:
        yield
    except PlanoptError:
        raise
    except Exception as error:
        if not is_own(part):
            raise
        name = f"{class_name(part)}.{method}" if method else class_name(part)
        module = getattr(part, "__module__", None) or type(part).__module__
        home = getattr(sys.modules.get(module), "__file__", None)
        frames = [one for one in traceback.extract_tb(error.__traceback__) if one.filename == home]
        raise InputError(
            f"{name} failed: {type(error).__name__}: {error}",
            file=frames[-1].filename if frames else None,
            row=frames[-1].lineno if frames else None,
            key=key,
            remedy=remedy or f"correct {f'the method {method}' if method else 'the code'}",
        ) from error


def returned(
    part: object,
    method: str,
    value: Any,
    shape: tuple[int, ...],
    *,
    words: str,
    key: str | None = None,
    unbounded: bool = False,
) -> NDArray[np.float64]:
    """Return the result of a part's method as a numeric array of the required shape."""
    import numpy as np  # imported late because the command line uses this module without numerics

    try:
        found = None if value is None else np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        found = None
    if found is None or found.shape != shape or not (unbounded or np.isfinite(found).all()):
        if found is None:
            got = f"a {type(value).__name__}"
        else:
            got = f"shape {found.shape}" if found.shape != shape else "NaN or infinite numbers"
        raise InputError(
            f"{class_name(part)}.{method} returned {got}"
            + (f", should return shape {shape}" if shape else ""),
            key=key,
            remedy=f"return {words}",
        )
    return found


def require_weights(weight: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return `weight` as non-negative floats (count,), or raise an InputError."""
    found = np.asarray(weight, dtype=np.float64)
    if found.shape != (count,) or not (np.isfinite(found).all() and (found >= 0.0).all()):
        raise InputError(
            f"has shape {found.shape}, should be {count} weights of at least 0",
            key="weight",
            remedy="give one weight for each position, or leave it out",
        )
    return found


def plain(value: Any) -> Any:
    """Return `value` with lists and arrays converted to tuples of Python numbers."""
    if isinstance(value, np.ndarray | np.generic):
        value = cast("Any", value).tolist()
    if isinstance(value, list | tuple):
        return tuple(plain(entry) for entry in cast("tuple[Any, ...]", value))
    return value


def make_plain(data: Any, *files: str) -> None:
    """Convert the fields of a frozen dataclass to plain values, or to paths if in `files`."""
    for part in fields(data):
        if not part.init:
            continue
        value = plain(getattr(data, part.name))
        if part.name in files and isinstance(value, str):
            value = Path(value)
        object.__setattr__(data, part.name, value)
