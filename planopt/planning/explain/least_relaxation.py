"""The least amount by which a key must be loosened for a verified plan, by solving again."""

from __future__ import annotations

from collections.abc import Callable

from planopt.planning.explain.key import Key

SETTLED_SHARE = 0.02
"""The least amount that helps is found to this share of itself."""

SHORT_SHARE = 0.05
"""An amount that is short by this share is tried at last: planners are not monotone."""

GROWTH = 4.0
"""Of the steps by which an amount grows until it helps, and at first shrinks."""

MOST_SOLVES = 20
"""Of one key."""


def least_relaxation(
    key: Key, helps: Callable[[float], bool], first: float, step: float, floor: float = 0.0
) -> float | None:
    """The value of a key nearest to what is asked that helps; None where none is found.

    Parameters
    ----------
    key
        The key.
    helps
        Whether the problem with a value of it, solved again, has a verified plan.
    first, step
        The amount that is tried first, and by how much more is tried then.
    floor
        An amount that is known not to help.
    """
    solves = 0

    def look(amount: float) -> tuple[bool, float]:
        nonlocal solves
        solves += 1
        value = key.loosened(amount)
        return helps(value), key.amount_of(value)

    def settled(failing: float, helping: float, close: bool) -> float:
        """The least amount that helps between one that does not and one that does.

        Bisected; at first by small steps from one that may be close to the least.
        """
        step = SETTLED_SHARE * helping
        gap = 1.0 if key.whole else step
        while helping - failing > gap and solves < MOST_SOLVES:
            middle = 0.5 * (failing + helping)
            amount = max(helping - step, middle) if close else middle
            if not failing < key.amount_of(key.loosened(amount)) < helping:
                break
            good, amount = look(amount)
            failing, helping = (failing, amount) if good else (amount, helping)
            step *= GROWTH
        return helping

    amount, failing = first, floor
    good, helping = look(amount)
    close = good and helping < key.most
    while not good:
        if helping >= key.most or solves >= MOST_SOLVES:
            return None
        failing = max(failing, helping)
        good, helping = look(helping + step)
        step *= GROWTH
    helping = settled(failing, helping, close)
    short = (1.0 - SHORT_SHARE) * helping
    if not key.whole and short > floor:
        good, amount = look(short)
        if good and amount < helping:
            helping = settled(floor, amount, close=True)
    return key.loosened(helping)
