"""What the callbacks of a built solver evaluate: exchanged for each solve, memoised by point."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planopt.planning.programme.stage_kernel import StageMargins

MarginFunction = Callable[[NDArray[np.float64]], StageMargins]


class MarginSource:
    """Margins and scores of all stages at a point, computed once however often it is asked.

    IPOPT asks for value, Jacobian and Hessian at one point in separate calls.
    """

    def __init__(self, stages: int) -> None:
        self.stages = stages
        self._evaluate: MarginFunction | None = None
        self._key = b""
        self._last: StageMargins | None = None

    def use(self, evaluate: MarginFunction) -> None:
        """Evaluate this from now on, and forget what the last one gave."""
        self._evaluate = evaluate
        self._last = None

    def at(self, flat: NDArray[np.float64]) -> StageMargins:
        """Margins and scores at positions flattened to ``(2 N,)``."""
        key = flat.tobytes()
        if self._last is None or key != self._key:
            if self._evaluate is None:
                raise AssertionError("a solver was called before its margins were set")
            self._last = self._evaluate(flat.reshape(-1, 2))
            self._key = key
        return self._last
