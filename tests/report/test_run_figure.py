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
    np.testing.assert_array_equal(image.get_array(), simulation.truths[0].raster.values)
    assert tuple(image.get_extent()) == (0.0, 100.0, 0.0, 80.0)


def test_driven_path_by_connection(simulation, log):
    """Each step looks as the place it leads to; neighbours alike are one line, so dashes show."""
    axes = draw_run(simulation).axes[0]
    good = collection_of(axes, "driven, connected").get_segments()
    bad = collection_of(axes, "driven, not connected").get_segments()
    np.testing.assert_array_equal(bad, [log.positions_m[1:3]])
    np.testing.assert_array_equal(good[0], log.positions_m[:2])
    np.testing.assert_array_equal(good[1], log.positions_m[2:])


def test_outages_show_without_colour(simulation):
    """Dashes on a dark casing are an outage, a light line on white is none: by lightness alone."""
    axes = draw_run(simulation).axes[0]
    good, bad = (
        collection_of(axes, f"driven, {words}") for words in ("connected", "not connected")
    )
    (_, dashes), (_, solid) = bad.get_linestyle()[0], good.get_linestyle()[0]
    assert dashes is not None and solid is None
    casings = [
        lines.get_edgecolor()[0]
        for lines in axes.collections
        if lines.get_linewidth()[0] > good.get_linewidth()[0]
    ]
    lightness = [float(colour[:3] @ [0.2126, 0.7152, 0.0722]) for colour in casings]
    assert lightness == [1.0, 0.0]


def test_no_outage_no_entry(simulation, log):
    """What a run does not have is not in its legend."""
    fine = replace(log, connected=np.ones_like(log.connected))
    figure = drawn(draw_run(replace(simulation, runs=(replace(simulation.run, log=fine),))))
    assert "driven, connected" in legend_of(figure)
    assert "driven, not connected" not in legend_of(figure)


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
        simulation,
        runs=(replace(simulation.run, log=start),),
        plans=((),),
        first_measurements=30,
    )
    entries = legend_of(drawn(draw_run(still)))
    assert not {"first plan", "bound relaxed", "measured on the way"} & set(entries)
