"""The map of a run."""

from dataclasses import replace

import numpy as np
from artists import collection_of, drawn, labels_of, legend_of, line_of

from planopt.report.run_figure import draw_run


def test_units_and_title(simulation):
    """Units on all axes; the outcome and its reason above."""
    figure = drawn(draw_run(simulation))
    assert labels_of(figure) == {"x [m]", "y [m]", "true power [dBm] (line: threshold)"}
    assert figure.axes[0].get_title(loc="left") == "step limit: six steps"


def test_layer_is_the_truth(simulation):
    """The layer is the true raster, at its place."""
    (image,) = draw_run(simulation).axes[0].images
    np.testing.assert_array_equal(image.get_array(), simulation.truth.raster.values)
    assert tuple(image.get_extent()) == (0.0, 100.0, 0.0, 80.0)


def test_driven_path_by_connection(simulation, log):
    """Each step has the colour of the place it leads to; together they are the driven path."""
    axes = draw_run(simulation).axes[0]
    good = collection_of(axes, "driven, connected").get_segments()
    bad = collection_of(axes, "driven, not connected").get_segments()
    np.testing.assert_array_equal(bad, [log.positions_m[1:3]])
    assert len(good) == 5
    np.testing.assert_array_equal(good[1], log.positions_m[2:4])


def test_first_plan_relaxed_steps_and_measurements(simulation, plan, log, measurements):
    """Each is where the data has it."""
    axes = draw_run(simulation).axes[0]
    np.testing.assert_array_equal(line_of(axes, "first plan").get_xydata(), plan.positions_m)
    relaxed = collection_of(axes, "bound relaxed").get_offsets()
    np.testing.assert_array_equal(relaxed, log.positions_m[[3]])
    before = collection_of(axes, "measured before").get_offsets()
    on_way = collection_of(axes, "measured on the way").get_offsets()
    np.testing.assert_array_equal(before, measurements.positions_m[:24])
    np.testing.assert_array_equal(on_way, measurements.positions_m[24:])


def test_run_of_no_step(simulation, log):
    """A run that ended where it began has neither plan nor relaxed steps to show."""
    start = replace(
        log,
        **{name: getattr(log, name)[:1] for name in log.__dataclass_fields__},
    )
    still = replace(
        simulation, run=replace(simulation.run, log=start), plans=(), first_measurements=30
    )
    entries = legend_of(drawn(draw_run(still)))
    assert not {"first plan", "bound relaxed", "measured on the way"} & set(entries)
