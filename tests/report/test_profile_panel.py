"""The words of a profile's confidence set."""

import math
from dataclasses import replace

import numpy as np
import pytest
from artists import panel_of
from matplotlib.figure import Figure

from planopt.channel.estimation.profile import CUT_95, Profile
from planopt.report.fit_figure import draw_profiles

INSIDE, OUTSIDE = -0.5 * CUT_95, -4.0 * CUT_95


@pytest.mark.parametrize(
    ("ends", "words"),
    [
        ((OUTSIDE, OUTSIDE), "to"),
        ((INSIDE, OUTSIDE), "below"),
        ((OUTSIDE, INSIDE), "above"),
        ((INSIDE, INSIDE), "anything"),
    ],
)
def test_words_say_which_ends_there_are(fit, ends, words):
    """Both ends, one or none, as the profile falls below the cut; the set is shaded up to them."""
    values = np.array([5.0, 10.0, 40.0])
    profile = Profile("decorrelation_m", values, np.array([ends[0], 0.0, ends[1]]), 10.0, 30)
    axes = Figure().subplots()
    draw_profiles([axes], [profile], fit)
    title = panel_of(axes.figure, "decorrelation").get_title(loc="left")
    assert words in title.split(":")[1]
    low, high = profile.interval_95()
    shaded = axes.collections[0].get_paths()[0].vertices[:, 0]
    assert shaded.min() >= max(low, 5.0) - 1e-9
    assert shaded.max() <= (40.0 + 1e-9 if math.isinf(high) else high)


def test_line_at_the_estimate_of_any_method(fit):
    """The vertical line is named after the method that was used."""
    profile = Profile("decorrelation_m", np.array([5.0, 10.0]), np.array([-1.0, 0.0]), 10.0, 30)
    axes = Figure().subplots()
    entries = draw_profiles([axes], [profile], replace(fit, method="lemma1"))
    assert entries[-1].get_label() == "estimate of lemma1"
    assert list(entries[-1].get_xdata()) == [15.0, 15.0]
