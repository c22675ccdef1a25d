# pyright: basic
"""NumPy functions of a path as CasADi callbacks: a quantity with its derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray


class PathCallback(ca.Callback):
    """A NumPy function of the flattened positions (2 N,) as a CasADi function."""

    def __init__(
        self,
        name: str,
        stages: int,
        size: int,
        evaluate: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    ) -> None:
        ca.Callback.__init__(self)
        self._stages = stages
        self._size = size
        self._evaluate = evaluate
        self.construct(name, {})

    def get_n_in(self) -> int:
        """One input."""
        return 1

    def get_n_out(self) -> int:
        """One output."""
        return 1

    def get_sparsity_in(self, _index: int) -> Any:
        """The positions, dense."""
        return ca.Sparsity.dense(2 * self._stages, 1)

    def get_sparsity_out(self, _index: int) -> Any:
        """The numbers, dense."""
        return ca.Sparsity.dense(self._size, 1)

    def has_eval_buffer(self) -> bool:
        """Numbers are read and written in place: ten times faster than as CasADi matrices."""
        return True

    def eval_buffer(self, arguments: Any, results: Any) -> int:
        """Ask the NumPy function."""
        numbers = np.frombuffer(results[0])
        numbers[:] = self._evaluate(np.frombuffer(arguments[0])).ravel()
        return 0


class Differentiated(Protocol):
    """A value, or one of each stage, with derivatives by the positions."""

    @property
    def value(self) -> float | NDArray[np.float64]:
        """The value, or ``(N,)``."""
        ...

    @property
    def gradient(self) -> NDArray[np.float64]:
        """``(N, 2)``."""
        ...

    @property
    def hessian(self) -> NDArray[np.float64]:
        """Return the numbers of the Hessian that are not zero."""
        ...


@dataclass(frozen=True)
class PathCallbacks:
    """The callbacks of one quantity."""

    value: PathCallback
    gradient: PathCallback
    hessian: PathCallback

    def __call__(self, at: Any) -> tuple[Any, Any, Any]:
        """Value, gradient and Hessian at positions (2 N,), a CasADi expression."""
        return self.value(at), self.gradient(at), self.hessian(at)


def path_callbacks(
    name: str,
    stages: int,
    values: int,
    curved: int,
    evaluate: Callable[[NDArray[np.float64]], Differentiated],
) -> PathCallbacks:
    """Callbacks of one quantity."""
    return PathCallbacks(
        PathCallback(name, stages, values, lambda at: np.asarray(evaluate(at).value)),
        PathCallback(
            f"{name}_gradient", stages, 2 * max(values, stages), lambda at: evaluate(at).gradient
        ),
        PathCallback(f"{name}_hessian", stages, curved, lambda at: evaluate(at).hessian),
    )
