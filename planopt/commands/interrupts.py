"""Interrupts and termination: running work stops, temporary files go, no signal is lost.

SIGTERM, by which schedulers and containers end a process, does what Ctrl-C does.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Generator

_active: list[list[int]] = []
"""Signals received by each block that is running, the outermost first."""


def _stop(number: int, _: object) -> None:
    # A second SIGTERM does not disturb the cleanup after the first.
    again = number == signal.SIGTERM and number in _active[-1]
    for received in _active:
        received.append(number)
    if not again:
        raise KeyboardInterrupt


@contextlib.contextmanager
def stopping() -> Generator[list[int]]:
    """Raise KeyboardInterrupt on SIGINT and SIGTERM within the block; yield the signals received.

    Only the main thread of a process has handlers; elsewhere nothing changes.
    """
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    _active.append(received)
    before = {number: signal.signal(number, _stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        _active.pop()


@contextlib.contextmanager
def interruptible() -> Generator[Callable[[], None]]:
    """Yield a function that raises an interrupt that was swallowed, such as by a CasADi callback.

    An interrupt that an enclosing block received and lost is raised at once.
    """
    if any(_active):
        raise KeyboardInterrupt
    with stopping() as received:

        def stop_if_interrupted() -> None:
            if received:
                raise KeyboardInterrupt

        yield stop_if_interrupted
