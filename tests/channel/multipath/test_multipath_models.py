"""Distributions of multipath against SciPy's."""

import numpy as np
import pytest
from multipath_law import law_of
from scipy.stats import norm

from planopt.channel.multipath.multipath_models import (
    Lognormal,
    Nakagami,
    Rician,
    multipath_survival,
    rician_mean_db,
)
from planopt.errors import InputError

LEVELS = np.linspace(-25.0, 12.0, 75)


@pytest.mark.parametrize("model", [Nakagami(0.5), Nakagami(5.76), Rician(0.3), Rician(10.0)])
def test_survival_is_scipys(model):
    """The power's distribution function at the level with the mean in dB put back."""
    law, mean = law_of(model)
    expected = law.sf(10.0 ** ((LEVELS + mean) / 10.0))
    np.testing.assert_allclose(multipath_survival(model, LEVELS), expected, atol=1e-12)


def test_rayleigh():
    """K = 0 and m = 1 are exponential power: P = exp(-power)."""
    power = 10.0 ** ((LEVELS + rician_mean_db(0.0)) / 10.0)
    for model in (Rician(0.0), Nakagami(1.0)):
        np.testing.assert_allclose(multipath_survival(model, LEVELS), np.exp(-power), atol=1e-12)


def test_lognormal_survival():
    """The normal tail; a step without fading."""
    np.testing.assert_allclose(multipath_survival(Lognormal(2.0), LEVELS), norm.sf(LEVELS / 2.0))
    np.testing.assert_array_equal(multipath_survival(Lognormal(0.0), LEVELS), LEVELS <= 0.0)


@pytest.mark.parametrize(
    "make", [lambda: Lognormal(-1.0), lambda: Nakagami(0.4), lambda: Rician(-1.0)]
)
def test_no_such_fading(make):
    """Parameters out of range are refused when given."""
    with pytest.raises(InputError):
        make()
