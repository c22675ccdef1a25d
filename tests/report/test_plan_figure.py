"""The figure of a plan."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from artists import collection_of, drawn, labels_of, legend_of, line_of, panel_of

from planopt.planning.plan import Verdict
from planopt.report.result_figures import WORDS_LINES, draw_plan
from planopt.report.style import BAND_Z


def test_units(solution):
    """All axes have units."""
    assert labels_of(drawn(draw_plan(solution))) == {
        "x [m]",
        "y [m]",
        "P(connected) [1] (line: p_min)",
        "time [s]",
        "power [dBm]",
        "P(connected) [1]",
    }


def test_path_is_the_plan(solution, plan):
    """The drawn path has the plan's waypoints, in the window, and the legend is off the map."""
    figure = draw_plan(solution)
    axes = panel_of(figure, "the plan on")
    path = line_of(axes, "planned waypoints and swept path")
    np.testing.assert_array_equal(path.get_xydata(), plan.positions_m)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert left < plan.positions_m[:, 0].min() and plan.positions_m[:, 0].max() < right
    assert bottom < plan.positions_m[:, 1].min() and plan.positions_m[:, 1].max() < top
    assert right - left == pytest.approx(10 * 2.0)  # ten longest steps of 2 m
    assert axes.get_legend() is None
    assert legend_of(figure)[0] == "planned waypoints and swept path"


def test_margin_is_the_clearance_away(solution, problem):
    """Every corner of the dashed outline is the clearance away from the obstacles."""
    far = replace(solution.plan, positions_m=solution.plan.positions_m * [4.0, 4.0])
    axes = panel_of(draw_plan(replace(solution, plans=(far,))), "the plan on")
    corners = np.concatenate(collection_of(axes, "clearance of 1.5 m").get_segments())
    obstacles = shapely.union_all([part.polygon for part in problem.workspace.obstacles])
    distances = shapely.distance(shapely.points(corners), obstacles)
    np.testing.assert_allclose(distances, 1.5, atol=1e-6)


def test_power_with_band(solution, plan):
    """Mean, band and threshold are the plan's."""
    axes = panel_of(draw_plan(solution), "predicted power")
    np.testing.assert_array_equal(
        axes.lines[0].get_xydata(), np.stack([plan.t_s, plan.mean_dbm], axis=1)
    )
    corners = collection_of(axes, "80 % band").get_paths()[0].vertices
    assert corners[:, 1].max() == pytest.approx((plan.mean_dbm + BAND_Z * plan.deviation_db).max())
    assert corners[:, 1].min() == pytest.approx((plan.mean_dbm - BAND_Z * plan.deviation_db).min())
    assert line_of(axes, "threshold").get_ydata()[0] == -72.0


def test_connectivity_with_relaxed_step(solution, plan):
    """Connectivity, p_min and the step that misses it."""
    axes = panel_of(draw_plan(solution), "predicted connectivity")
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), plan.connectivity)
    assert line_of(axes, "p_min = 0.8").get_ydata()[0] == 0.8
    offsets = collection_of(axes, "not met").get_offsets()
    np.testing.assert_allclose(offsets, [[plan.t_s[3], plan.connectivity[3]]])


def test_certificate_in_words(solution):
    """The certificate's numbers stand in the figure."""
    figure = draw_plan(solution)
    words = "\n".join(text.get_text() for axes in figure.axes for text in axes.texts)
    for number in ("1.625 m", "0.812", "2.5e-09", "3.5e-07", "101.2", "103.5", "0.75 dB"):
        assert number in " ".join(words.split())


def test_many_reasons_are_cut(solution):
    """More words than there is room for end in dots."""
    reasons = tuple(f"reason {number}" for number in range(30))
    certificate = replace(solution.plan.certificate, reasons=reasons)
    plan = replace(solution.plan, certificate=certificate, verdict=Verdict.VIOLATED)
    figure = draw_plan(replace(solution, plans=(plan,)))
    (words,) = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert len(words.splitlines()) == WORDS_LINES and words.endswith("...")


def test_inset_shows_the_window(solution):
    """A small window has an inset of the whole workspace with the window in it; a wide one not."""
    figure = drawn(draw_plan(solution))
    axes = panel_of(figure, "the plan on")
    (inset,) = axes.child_axes
    assert inset.get_xlim() == (0.0, 100.0)
    frame = inset.lines[-1].get_xydata()
    np.testing.assert_allclose(frame[[0, 2]].T, [axes.get_xlim(), axes.get_ylim()])
    wide = replace(solution.plan, positions_m=10.0 * solution.plan.positions_m - 90.0)
    assert not panel_of(draw_plan(replace(solution, plans=(wide,))), "the plan on").child_axes


def test_standing_plan_without_obstacles(solution, problem):
    """A plan that stands still in an empty world is drawn in a window that is not empty."""
    empty = replace(problem, workspace=replace(problem.workspace, obstacles=()))
    certificate = replace(
        solution.plan.certificate, min_clearance_m=float("inf"), relaxed_steps=(), relaxation_db=()
    )
    still = replace(solution.plan, positions_m=np.full((5, 2), 10.0), certificate=certificate)
    figure = drawn(draw_plan(replace(solution, problem=empty, plans=(still,))))
    assert panel_of(figure, "the plan on").get_xlim() == (0.0, 20.0)
