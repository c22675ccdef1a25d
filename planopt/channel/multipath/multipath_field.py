"""Multipath of the truth: its law from whichever of m, K and omega is known, and draws of it.

Every law has unit mean power in the linear domain, and its mean in dB is then subtracted, so that
path loss and shadowing keep their meaning (equation 1.5).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.channel.multipath.multipath_models import (
    Lognormal,
    Multipath,
    Nakagami,
    Rician,
    nakagami_m_of_rician,
    nakagami_m_of_std,
    nakagami_mean_db,
    nakagami_std_db,
    rician_field_db,
    rician_k_of_nakagami,
    rician_k_of_std,
    rician_std_db,
)
from planopt.errors import InputError

MultipathKind = Literal["nakagami", "rician", "rayleigh", "lognormal"]


def multipath_of(
    kind: MultipathKind,
    *,
    m: float | None = None,
    k: float | None = None,
    std_db: float | None = None,
) -> Multipath:
    """The multipath of one kind, given by exactly one of m, K and omega.

    Parameters
    ----------
    kind
        ``rayleigh``, which takes no number, or one of the others.
    m
        Nakagami's m. For ``rician`` the K of the same variance of the power, for ``lognormal`` the
        exact deviation of Nakagami fading.
    k
        Rician K, linear. For ``nakagami`` the m of the same variance of the power, for
        ``lognormal`` the exact deviation of Rician fading.
    std_db
        omega, the deviation in dB; exact for every kind.

    Raises
    ------
    InputError
        Not exactly one of them, or one for which there is no such multipath.
    """
    given = [name for name, value in (("m", m), ("k", k), ("std_db", std_db)) if value is not None]
    wanted = 0 if kind == "rayleigh" else 1
    if len(given) != wanted:
        raise InputError(
            f"{kind} multipath is given by {' and '.join(given) or 'nothing'}",
            key="multipath",
            remedy="give the kind alone" if wanted == 0 else "give one of m, k and std_db",
        )
    if kind == "nakagami":
        return Nakagami(_nakagami_m(m, k, std_db))
    if kind == "rician":
        return Rician(_rician_k(m, k, std_db))
    if kind == "lognormal":
        return Lognormal(_std_db(m, k, std_db))
    return Rician(0.0)


def multipath_field_db(
    shape: tuple[int, ...], multipath: Multipath, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Independent values in dB, of mean zero and deviation ``multipath.std_db``.

    Parameters
    ----------
    shape
        Shape of the result.
    multipath
        The law.
    generator
        Source of randomness.
    """
    if isinstance(multipath, Lognormal):
        return multipath.std_db * generator.standard_normal(shape)
    if isinstance(multipath, Rician):
        return rician_field_db(shape, multipath.k_factor, generator)
    # The power is Gamma(m) / m (equation 1.5).
    power = generator.standard_gamma(multipath.m, shape) / multipath.m
    return 10.0 * np.log10(power) - nakagami_mean_db(multipath.m)


def _nakagami_m(m: float | None, k: float | None, std_db: float | None) -> float:
    if m is not None:
        return m
    return nakagami_m_of_std(std_db or 0.0) if k is None else nakagami_m_of_rician(k)


def _rician_k(m: float | None, k: float | None, std_db: float | None) -> float:
    if k is not None:
        return k
    return rician_k_of_std(std_db or 0.0) if m is None else rician_k_of_nakagami(m)


def _std_db(m: float | None, k: float | None, std_db: float | None) -> float:
    if std_db is not None:
        return std_db
    return rician_std_db(k or 0.0) if m is None else nakagami_std_db(m)
