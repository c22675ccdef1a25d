"""The least amount by which a key must be loosened for a verified plan, by solving again."""

from __future__ import annotations

from collections.abc import Callable

from planopt.planning.explain.key import Key

SETTLED_SHARE = 0.02
"""The least amount that helps is found to this share of itself."""

SHORT_SHARE = 0.05
"""An amount that is short by this share is tried at last: planners are not monotone."""

GROWTH = 2.5
"""Of the steps by which an amount grows until it helps, and shrinks until it does not."""

MOST_SOLVES = 24
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
    amount, failing, solves = first, floor, 0
    while True:
        value = key.loosened(amount)
        helping = key.amount_of(value)
        solves += 1
        if helps(value):
            break
        if helping >= key.most or solves >= MOST_SOLVES:
            return None
        failing = max(failing, helping)
        amount, step = helping + step, GROWTH * step
    step = SETTLED_SHARE * helping
    proven = floor
    while solves < MOST_SOLVES:
        if helping - failing > (1.0 if key.whole else SETTLED_SHARE * helping):
            amount = helping - step if helping - step > failing else 0.5 * (failing + helping)
        elif proven < (1.0 - SHORT_SHARE) * helping < failing:
            amount, proven = (1.0 - SHORT_SHARE) * helping, (1.0 - SHORT_SHARE) * helping
            failing = floor
        else:
            break
        found = key.amount_of(key.loosened(amount))
        if not failing < found < helping:
            break
        solves += 1
        if helps(key.loosened(amount)):
            helping, step = found, GROWTH * step
        else:
            failing = found
    return key.loosened(helping)
