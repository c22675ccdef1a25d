"""SciPy's counterparts of the distributions of multipath, for the tests."""

from scipy.stats import gamma, ncx2

from planopt.channel.multipath.multipath_models import Nakagami, nakagami_mean_db, rician_mean_db


def law_of(model):
    """SciPy's distribution of the power, and the mean in dB."""
    if isinstance(model, Nakagami):
        return gamma(model.m, scale=1.0 / model.m), nakagami_mean_db(model.m)
    k = model.k_factor
    return ncx2(2.0, 2.0 * k, scale=0.5 / (k + 1.0)), rician_mean_db(k)
