"""The time series of a run."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from artists import collection_of, drawn, labels_of, line_of, panel_of

from planopt.planning.plan import Rung
from planopt.report.run_figure import RUNG_LOOKS, draw_run_series


def test_units(simulation):
    """All curves have units."""
    assert labels_of(drawn(draw_run_series(simulation))) == {
        "time [s]",
        "power [dBm]",
        "P(connected) [1]",
        "step time [ms]",
    }


def test_power_curves(simulation, log):
    """Prediction, band, truth and threshold are the log's."""
    axes = panel_of(draw_run_series(simulation), "received power")
    predicted = line_of(axes, "predicted one step ahead").get_xydata()
    np.testing.assert_array_equal(predicted, np.stack([log.t_s, log.predicted_dbm], axis=1))
    np.testing.assert_array_equal(line_of(axes, "true").get_ydata(), log.true_dbm)
    assert line_of(axes, "threshold").get_ydata()[0] == -72.0
    corners = collection_of(axes, "80 % band").get_paths()[0].vertices
    assert corners[:, 1].min() == pytest.approx(-70.0 - 1.28 * 5.0)


def test_connection_strip(simulation):
    """Bars tile the time; the one that is not connected stands around its time; the share."""
    axes = panel_of(draw_run_series(simulation), "connected in truth: 83.3 % of the steps")
    bars = sorted((bar.get_x(), bar.get_x() + bar.get_width()) for bar in axes.patches)
    assert bars[0][0] == 0.0 and bars[-1][1] == 12.0
    assert all(first[1] == second[0] for first, second in pairwise(bars))
    colours = {bar.get_x(): bar.get_facecolor() for bar in axes.patches}
    assert colours[3.0] != colours[1.0] == colours[5.0]


def test_connectivity_curve(simulation, log):
    """Connectivity, p_min, and the relaxed step."""
    axes = panel_of(draw_run_series(simulation), "predicted connectivity")
    curve = line_of(axes, "predicted one step ahead")
    np.testing.assert_array_equal(curve.get_ydata(), log.connectivity)
    relaxed = collection_of(axes, "bound relaxed").get_offsets()
    np.testing.assert_allclose(relaxed, [[log.t_s[3], log.connectivity[3]]])


def test_step_times_by_rung(simulation):
    """Milliseconds at the steps of each rung, the start left out."""
    axes = panel_of(draw_run_series(simulation), "planning time")
    plans = collection_of(axes, "plan (4)").get_offsets()
    np.testing.assert_allclose(plans, [[2.0, 20.0], [4.0, 30.0], [10.0, 50.0], [12.0, 20.0]])
    relaxed = collection_of(axes, "relaxed (1)").get_offsets()
    np.testing.assert_allclose(relaxed, [[6.0, 10.0]])
    assert axes.get_yscale() == "log"


def test_every_rung_has_a_look():
    """Rungs are told apart, all of them."""
    assert set(RUNG_LOOKS) == set(Rung) and len(set(RUNG_LOOKS.values())) == len(Rung)


def test_run_of_no_step(simulation, log):
    """A run that ended where it began is drawn, with a word on it."""
    start = replace(log, **{name: getattr(log, name)[:1] for name in log.__dataclass_fields__})
    still = replace(simulation, runs=(replace(simulation.run, log=start),))
    axes = panel_of(drawn(draw_run_series(still)), "planning time")
    assert [text.get_text() for text in axes.texts] == ["no step was released"]
