"""By which methods a channel is estimated, and what has a choice of loss."""

from __future__ import annotations

from typing import Literal, cast, get_args

from planopt.errors import InputError

FitMethod = Literal["lemma1", "capped", "convex", "nls", "reml"]

Loss = Literal["squares", "huber", "absolute"]

GivenMethod = FitMethod | Literal["seed"]
"""What a caller may write: today's names and those of `ALIASES`."""

ALIASES = {"seed": "lemma1"}
"""Earlier names, which are still understood."""


def current_name(method: str) -> str:
    """Return the current name of a method that may be given by an earlier one."""
    return ALIASES.get(method, method)


def require_method(method: str, key: str) -> FitMethod:
    """Return the method of that name, or refuse; `key` is what it was given by."""
    name = current_name(method)
    if name not in get_args(FitMethod):
        remedy = f"use {', '.join(get_args(FitMethod))}"
        raise InputError(f"{method!r} is no method", key=key, remedy=remedy)
    return cast(FitMethod, name)


def require_loss(loss: str, method: FitMethod, key: str) -> None:
    """Refuse a loss that does not exist, or is not the method's; `key` is what it was given by."""
    if loss not in get_args(Loss):
        raise InputError(f"{loss!r} is no loss", key=key, remedy=f"use {', '.join(get_args(Loss))}")
    if loss != "squares" and method != "convex":
        raise InputError(
            f"{method} has no choice of loss", key=key, remedy="use it with method convex"
        )
