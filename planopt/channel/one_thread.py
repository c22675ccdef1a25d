"""One BLAS thread for the many small factorisations of an estimate.

The matrices are too small to gain from threads, and on a machine whose cores are busy OpenBLAS
spins while its threads wait for each other: a fit of 102 measurements then took 6 s, not 20 ms.
One thread also makes the result independent of the machine's number of cores.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from functools import cache

# NumPy's and SciPy's BLAS must be loaded before the controller looks for them.
import scipy.linalg  # noqa: F401  # pyright: ignore[reportUnusedImport]
from threadpoolctl import ThreadpoolController


@contextmanager
def one_blas_thread() -> Generator[None]:
    """Limit BLAS to one thread inside; a context manager, or a decorator when called."""
    with _controller().limit(limits=1, user_api="blas"):  # pyright: ignore[reportUnknownMemberType]
        yield


@cache
def _controller() -> ThreadpoolController:
    """Finding the loaded libraries takes milliseconds, so once is enough."""
    return ThreadpoolController()
