"""Worker processes end when the process that started them does, however it ended."""

from __future__ import annotations

import os
import threading
import time

CHECK_EVERY_S = 1.0
"""How often a worker looks for its parent."""

_NAME = "end-with-parent"


def end_with_parent(parent: int) -> None:
    """End this process, without further ado, soon after the process `parent` has ended.

    A process that is killed cannot tell its workers to stop, and theirs would go on for hours.
    Calling this again changes nothing.

    Parameters
    ----------
    parent
        Its id. Nothing is done if that is not the parent of this process.
    """
    watched = any(thread.name == _NAME for thread in threading.enumerate())
    if watched or os.getppid() != parent:
        return

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(CHECK_EVERY_S)
        os._exit(1)

    threading.Thread(target=watch, name=_NAME, daemon=True).start()
