"""Figures of the channel: maps, fits, calibration, reliability, sensitivity, found stations."""

from dataclasses import replace

import numpy as np
import pytest
from artists import collection_of, drawn, labels_of, legend_of, line_of, panel_of

from planopt import InputError
from planopt.channel import (
    Measurements,
    Prediction,
    Station,
    condition,
    held_out_report,
    posterior_map,
)
from planopt.channel.calibration import GroupedRatio, reliability
from planopt.report import (
    draw_belief,
    draw_calibration,
    draw_fit,
    draw_posterior_map,
    draw_reliability,
    draw_sensitivity,
    draw_stations,
)

MEASURED = ["measured", "measured at the floor (censored)"]
ERRORS = [-0.5, 0.0, 0.5]
CURVES = {"n_pl": np.array([40.0, 10.0, 50.0]), "decorrelation_m": np.array([10.5, 10.0, 10.25])}
TRUE = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
NEAR = TRUE + [3.0, 4.0]
FAR = TRUE + np.array([[6.0, 8.0], [0.0, 20.0], [30.0, 0.0], [0.0, 40.0]])
PASSED = np.array([[5.0, 5.0], [6.0, 5.0]])


@pytest.fixture(scope="module")
def maps(fit, measurements):
    """Ten by eight cells, narrower than the measured area."""
    return posterior_map(condition(fit.parameters, measurements), (0, 0, 70, 56), 7.0, -72.0)


@pytest.fixture(scope="module")
def calibrations():
    """One prediction with the right standard deviation, one with half of it."""
    power = np.random.default_rng(0).normal(0.0, 2.0, 200)
    data = Measurements(np.zeros((200, 2)), power, np.arange(200) < 10)
    groups = np.arange(200) % 8

    def predictor(deviation_db):
        return lambda held_out: Prediction(
            np.zeros(len(held_out)), np.full(len(held_out), deviation_db)
        )

    predictors = {"path_loss": predictor(2.0), "sure": predictor(1.0)}
    return held_out_report(data, groups, groups, lambda _: predictors).scores


def bins(optimism: float):
    """Bins of eight runs of 50 steps, predicted `optimism` too high."""
    generator = np.random.default_rng(1)
    predicted = generator.uniform(0.6, 1.0, 400)
    realised = generator.uniform(size=400) < predicted - optimism
    return reliability(predicted, realised, np.arange(400) % 8)


@pytest.fixture(scope="module")
def figures(problem, belief, measurements, fit, maps, calibrations):
    """Every figure of the channel, rendered, by name."""
    station = fit.parameters.station
    return {
        "belief": drawn(draw_belief(problem, belief)),
        "map": drawn(draw_posterior_map(maps, measurements, Station((35.0, 20.0)), "a log")),
        "fit": drawn(draw_fit(measurements, fit, station)),
        "calibration": drawn(draw_calibration(calibrations)),
        "reliability": drawn(draw_reliability({"right": bins(0.0), "too high": bins(0.2)}, "two")),
        "sensitivity": drawn(draw_sensitivity(ERRORS, CURVES)),
        "stations": drawn(draw_stations(TRUE, {"near": NEAR, "far": FAR}, PASSED)),
    }


def test_units_and_legends(figures):
    """Every axis has its unit, every series its name."""
    for figure in figures.values():
        assert all("[" in label for label in labels_of(figure))
    legends = {
        "belief": ["start", "goal", "station", *MEASURED, "p_min = 0.8"],
        "map": [*MEASURED, "station", "-72 dBm"],
        "calibration": ["path_loss: RMSE 1.94 dB", "sure: RMSE 1.94 dB", "nominal"],
        "reliability": ["as predicted", "right", "too high"],
        "sensitivity": ["path loss exponent, n_PL", "decorrelation distance, β"],
        "stations": ["true", "estimated", "measured position"],
    }
    assert {name: legend_of(figures[name]) for name in legends} == legends


def test_maps_of_a_belief_are_the_prediction(figures, belief):
    """Values in the three images at a free place equal the posterior's there."""
    images = [
        panel_of(figures["belief"], title).images[0]
        for title in ("predicted power", "standard deviation of", "P(power ≥ -72 dBm)")
    ]
    left, right, bottom, top = images[0].get_extent()
    rows, columns = images[0].get_array().shape
    x = left + (columns // 8 + 0.5) * (right - left) / columns
    y = bottom + (rows // 8 + 0.5) * (top - bottom) / rows
    prediction = belief.posterior.predict(np.array([[x, y]]))
    chance = belief.posterior.connectivity(np.array([[x, y]]), -72.0)
    shown = [image.get_array()[rows // 8, columns // 8] for image in images]
    expected = [prediction.mean_db[0], prediction.deviation_db[0], chance[0]]
    np.testing.assert_allclose(shown, expected, rtol=1e-9)


def test_measurements_are_dots(figures, measurements):
    for name, title in (("belief", "predicted power"), ("map", "standard deviation")):
        dots = [
            each
            for each in panel_of(figures[name], title).collections
            if len(each.get_offsets()) in (25, 5) and "measured" not in each.get_label()
        ]
        filled, hollow = dots
        np.testing.assert_array_equal(filled.get_offsets(), measurements.positions_m[:25])
        np.testing.assert_array_equal(hollow.get_offsets(), measurements.positions_m[25:])
        assert len(filled.get_facecolors()) == 1 and len(hollow.get_facecolors()) == 0


def test_posterior_maps(figures, maps, measurements):
    """Each raster in its panel, cut at the edges of the cells; the station only if inside."""
    for title, raster in (
        ("predicted power", maps.mean_db),
        ("standard deviation", maps.deviation_db),
        ("P(power ≥ -72 dBm)", maps.connectivity),
    ):
        axes = panel_of(figures["map"], title)
        np.testing.assert_array_equal(axes.images[0].get_array(), raster.values)
        assert axes.get_xlim() == (0, 70) and axes.get_ylim() == (0, 56)
    assert figures["map"].get_suptitle() == "a log"
    exact = replace(measurements, censored=np.zeros(30, dtype=bool))
    away = drawn(draw_posterior_map(maps, exact, Station((35.0, 60.0)), ""))
    assert legend_of(away) == ["measured", "-72 dBm"]


def test_power_by_distance(figures, measurements):
    """Dots at the 3-D distance; the line is K_PL - 10 n_PL log10 d, two deviations around it."""
    axes = panel_of(figures["fit"], "path loss")
    offset = measurements.positions_m - [50.0, 60.0]
    distance = np.sqrt((offset**2).sum(axis=1) + 25.0)
    dots = np.stack([distance, measurements.power_dbm], axis=1)
    for label, chosen in (("measured", slice(25)), ("upper limit (censored)", slice(25, None))):
        np.testing.assert_allclose(collection_of(axes, label).get_offsets(), dots[chosen])
    (line,) = axes.lines
    distance, power = line.get_xydata().T
    np.testing.assert_allclose(power, -30.0 - 25.0 * np.log10(distance))
    corners = collection_of(axes, "±2 standard deviations").get_paths()[0].vertices
    top = corners[np.isclose(corners[:, 0], distance[0]), 1].max()
    assert top - power[0] == pytest.approx(2.0 * np.sqrt(4.0**2 + 1.5**2))
    assert line.get_label() == "-30.0 dBm - 25.0 dB log10(d / 1 m)"


def test_coverage_and_pit(figures, calibrations):
    """Coverage in percent against level, the PIT as steps, no bar where an interval ends."""
    sure = calibrations["sure"]
    line = line_of(panel_of(figures["calibration"], "coverage"), "sure: RMSE 1.94 dB")
    expected = [[100.0 * level, 100.0 * one.value] for level, one in sure.coverage.items()]
    np.testing.assert_allclose(line.get_xydata(), expected)
    (steps,) = (
        patch
        for patch in panel_of(figures["calibration"], "integral").patches
        if patch.get_label() == "sure"
    )
    np.testing.assert_allclose(steps.get_data().values, 100.0 * sure.pit_share)
    np.testing.assert_allclose(
        steps.get_data().edges, np.linspace(0.0, 1.0, len(sure.pit_share) + 1)
    )
    past = GroupedRatio(1.0, 1.0 + 1e-15, 1.0 - 1e-15)
    drawn(draw_calibration({"past": replace(calibrations["sure"], coverage={0.5: past})}))


def test_reliability_points(figures):
    """Percent against percent, and the difference in percentage points."""
    high = bins(0.2)
    line = line_of(panel_of(figures["reliability"], "reliability"), "too high").get_xydata()
    np.testing.assert_allclose(line, [[100 * b.predicted, 100 * b.realised] for b in high])
    apart = line_of(panel_of(figures["reliability"], "observed minus"), "too high").get_ydata()
    np.testing.assert_allclose(apart, [100 * (b.realised - b.predicted) for b in high])


def test_found_stations(figures):
    """Lines from true positions to the first method's; errors step from none to all."""
    scene, errors = figures["stations"].axes
    joined = next(line for line in scene.get_lines() if len(line.get_xdata()) == 12)
    ends = np.asarray(joined.get_xydata()).reshape(4, 3, 2)
    np.testing.assert_array_equal(ends[:, :2], np.stack([TRUE, NEAR], axis=1))
    assert np.isnan(ends[:, 2]).all()
    near, far = errors.get_lines()
    np.testing.assert_allclose(near.get_xdata(), 5.0)
    np.testing.assert_allclose(far.get_xdata(), [10, 10, 20, 20, 30, 30, 40, 40])
    np.testing.assert_allclose(far.get_ydata(), [0, 25, 25, 50, 50, 75, 75, 100])
    assert near.get_label() == "near: median 5.00 m, 90 % 5.00 m"
    assert far.get_label() == "far: median 25.00 m, 90 % 37.00 m"


@pytest.mark.parametrize(
    "draw",
    [
        lambda: draw_calibration({}),
        lambda: draw_reliability({"nothing": ()}, "none"),
        lambda: draw_sensitivity(ERRORS, {}),
        lambda: draw_sensitivity(ERRORS, {"n_pl": np.array([1.0, 2.0])}),
        lambda: draw_stations(TRUE, {}, PASSED),
        lambda: draw_stations(TRUE, {"short": NEAR[:2]}, PASSED),
    ],
)
def test_nothing_to_draw(draw):
    with pytest.raises(InputError):
        draw()
