"""By which methods a channel is estimated, and what has a choice of loss."""

from __future__ import annotations

from typing import Literal, get_args

from planopt.channel.estimation.convex_fit import Loss
from planopt.errors import InputError

FitMethod = Literal["seed", "capped", "convex", "nls", "reml"]


def require_method(method: str, key: str) -> None:
    """Refuse a method that does not exist; `key` is what it was given by."""
    if method not in get_args(FitMethod):
        remedy = f"use {', '.join(get_args(FitMethod))}"
        raise InputError(f"{method!r} is no method", key=key, remedy=remedy)


def require_loss(loss: str, method: FitMethod, key: str) -> None:
    """Refuse a loss that does not exist, or is not the method's; `key` is what it was given by."""
    if loss not in get_args(Loss):
        raise InputError(f"{loss!r} is no loss", key=key, remedy=f"use {', '.join(get_args(Loss))}")
    if loss != "squares" and method != "convex":
        raise InputError(
            f"{method} has no choice of loss", key=key, remedy="use it with method convex"
        )
