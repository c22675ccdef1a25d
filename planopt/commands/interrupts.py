"""Interrupts and termination: what is under way stops, temporary files go, nothing is lost.

SIGTERM, by which schedulers and containers end a process, does what Ctrl-C does.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Generator
from dataclasses import dataclass
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Signals that ask a process to stop."""


@dataclass(frozen=True)
class _Handler:
    """Records a signal, tells the handler that was there before, and raises KeyboardInterrupt."""

    before: dict[signal.Signals, Any]
    received: list[int]

    def __call__(self, number: int, frame: FrameType | None) -> None:
        # A second SIGTERM does not disturb the cleanup after the first.
        again = number == signal.SIGTERM and number in self.received
        self.received.append(number)
        outer = self.before[signal.Signals(number)]
        if callable(outer) and outer is not signal.default_int_handler:
            outer(number, frame)
        if not again:
            raise KeyboardInterrupt


@contextlib.contextmanager
def stopping() -> Generator[list[int]]:
    """Raise KeyboardInterrupt on any of `SIGNALS` within the block; yield the signals received.

    Only the main thread of a process has handlers; elsewhere nothing changes.
    """
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    handler = _Handler({number: signal.getsignal(number) for number in SIGNALS}, received)
    for number in SIGNALS:
        signal.signal(number, handler)
    try:
        yield received
    finally:
        for number, before in handler.before.items():
            signal.signal(number, before)


@contextlib.contextmanager
def interruptible() -> Generator[Callable[[], None]]:
    """Yield a function that raises an interrupt that was swallowed, such as by a CasADi callback.

    An interrupt that an enclosing block received and lost, as in a callback of an import, is raised
    at once.
    """
    outer = signal.getsignal(signal.SIGTERM)
    if isinstance(outer, _Handler) and outer.received:
        raise KeyboardInterrupt
    with stopping() as received:

        def stop_if_interrupted() -> None:
            if received:
                raise KeyboardInterrupt

        yield stop_if_interrupted
