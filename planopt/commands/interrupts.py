"""Interrupts and termination: what is under way stops, temporary files go, nothing is lost.

SIGTERM, by which schedulers and containers end a process, does what Ctrl-C does.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Generator
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Signals that ask a process to stop."""


@contextlib.contextmanager
def stopping() -> Generator[list[int]]:
    """Let every signal of `SIGNALS` raise KeyboardInterrupt within, and say which came.

    A handler that was there before is called as well, so that a block within another tells the
    outer one. Only the main thread of a process has handlers; elsewhere nothing changes.
    """
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}

    def handle(number: int, frame: FrameType | None) -> None:
        # Asked again to terminate while it is doing so, a process goes on cleaning up.
        again = number == signal.SIGTERM and number in received
        received.append(number)
        outer = before[signal.Signals(number)]
        if callable(outer) and outer is not signal.default_int_handler:
            outer(number, frame)
        if not again:
            raise KeyboardInterrupt

    for number in SIGNALS:
        signal.signal(number, handle)
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def interruptible() -> Generator[Callable[[], None]]:
    """Let nothing swallow an interrupt: CasADi answers one by ending the solve that it is in."""
    with stopping() as received:

        def stop_if_interrupted() -> None:
            if received:
                raise KeyboardInterrupt

        yield stop_if_interrupted
