"""Pictures of teams: their map, their curves, and what is left out."""

from dataclasses import replace

import numpy as np
import pytest
from artists import collection_of, drawn, labels_of, legend_of, line_of, panel_of
from teams import team_problem, team_run

from planopt.commands.pictures import picture_run, picture_solution
from planopt.planning.plan import Verdict
from planopt.planning.solution import Solution
from planopt.planning.worth.situation import Aim
from planopt.problems.channel_setup import GivenParameters
from planopt.report.result_figures import draw_team_plan, draw_team_run

ALWAYS = {"x [m]", "y [m]", "RMS error [dB]", "time [s]"}


@pytest.mark.parametrize(
    ("task", "more"),
    [
        ("track", {"P(connected) [1]", "trace P [m²]"}),
        ("learn", {"power [dBm]", "trace M / |θ|² [dB]"}),
        ("map", {"power [dBm]", "deviation [dB]", "trace M / |θ|² [dB]"}),
    ],
)
def test_units_of_a_run(simulation, task, more):
    """Every task has its own maps and curves, units on all axes, and no other panels."""
    assert labels_of(drawn(draw_team_run(team_run(simulation, task)))) == ALWAYS | more


def test_known_path_loss_has_no_panel(simulation):
    """Its uncertainty is nothing to draw; what is estimated has its curve."""
    run = team_run(simulation, "map")
    known = GivenParameters(
        shadow_std_db=4.0, decorrelation_m=10.0, multipath_std_db=1.0, k_pl_db=-10.0, n_pl=2.0
    )
    labels = []
    for given in (known, replace(known, k_pl_db=None, n_pl=None)):
        channel = replace(run.problem.channel, given=given)
        labels.append(
            labels_of(
                drawn(draw_team_run(replace(run, problem=replace(run.problem, channel=channel))))
            )
        )
    assert labels[1] - labels[0] == {"trace M / |θ|² [dB]"}


@pytest.mark.parametrize("robots", [1, 3])
def test_every_robot_is_drawn_in_its_look(simulation, robots):
    """Tracks and plans are where the data has them; no two robots look the same."""
    run = team_run(simulation, "learn", robots)
    figure = drawn(draw_team_run(run))
    looks = set()
    for one, plans in zip(run.runs, run.plans, strict=True):
        track = line_of(figure.axes[0], f"{one.robot}, driven")
        plan = line_of(figure.axes[0], f"{one.robot}, planned")
        np.testing.assert_array_equal(track.get_xydata(), one.log.positions_m)
        np.testing.assert_array_equal(plan.get_xydata(), plans[-1].positions_m[1:])
        assert track.get_color() == plan.get_color()
        assert track.get_marker() == plan.get_marker()
        looks.add((track.get_color(), track.get_marker()))
    assert len(looks) == robots
    assert len(legend_of(figure)) == 3 + 2 * robots
    measured = collection_of(figure.axes[0], "measured before").get_offsets()
    assert len(measured) == simulation.first_measurements


def test_target_and_its_estimates(simulation):
    """The true way, the estimates, and the trace marked by whether a packet arrived."""
    run = team_run(simulation, "track")
    figure = drawn(draw_team_run(run))
    ground, curve = figure.axes[0], panel_of(figure, "uncertainty of the target")
    np.testing.assert_array_equal(
        line_of(ground, "target, true way").get_xydata(), run.target.true_m
    )
    np.testing.assert_array_equal(
        collection_of(ground, "the station's estimates").get_offsets(), run.target.station_mean_m
    )
    assert curve.get_yscale() == "log"
    lost = collection_of(curve, "none arrived").get_offsets()
    np.testing.assert_allclose(lost, [[4.0, run.target.station_variance_m2[2]]])
    assert len(collection_of(curve, "packets arrived").get_offsets()) == 5


def test_a_small_team_has_a_window(simulation):
    """Where robots, target and station are near each other, the map is a square about them."""
    run = team_run(simulation, "track")
    radio = run.problem.stations[0]
    near = replace(radio, position_m=(15.0, 20.0))
    figure = drawn(draw_team_run(replace(run, problem=replace(run.problem, stations=(near,)))))
    (left, right), (low, top) = figure.axes[0].get_xlim(), figure.axes[0].get_ylim()
    assert right - left == pytest.approx(top - low)
    assert right - left < 60.0
    assert left < 10.0 < 22.0 < right
    assert low < 10.0 < 28.0 < top
    assert len(figure.axes[0].child_axes) == 1


def test_connections_by_robot(simulation):
    """A curve of predicted connectivity and a row of true connections for each robot."""
    run = team_run(simulation, "track")
    figure = drawn(draw_team_run(run))
    curves = panel_of(figure, "one step ahead")
    assert [line.get_label() for line in curves.lines] == ["robot 0", "robot 1", "robot 2"]
    rows = panel_of(figure, "connected in truth")
    assert [text.get_text() for text in rows.get_yticklabels()] == ["robot 0", "robot 1", "robot 2"]
    lost = [c.get_offsets() for c in rows.collections if len(c.get_offsets()) == 1]
    np.testing.assert_array_equal(np.concatenate(lost), [[4.0, 0.0], [4.0, 1.0], [4.0, 2.0]])


def test_bound_is_drawn_where_there_is_one(simulation):
    """With p_min there is its line and, for other tasks, the panels of connections."""
    bounded = drawn(draw_team_run(team_run(simulation, "learn", p_min=0.8)))
    line = line_of(panel_of(bounded, "one step ahead"), "p_min = 0.8")
    assert list(line.get_ydata()) == [0.8, 0.8]
    tracked = drawn(draw_team_run(team_run(simulation, "track", p_min=0.8)))
    assert "P(connected) [1] (line: p_min)" in labels_of(tracked)


def test_rungs_and_verdicts(simulation):
    """Every released plan has the mark of its rung; one that is not verified has a ring."""
    run = team_run(simulation, "learn", 2)
    verdicts = (*run.runs[1].log.verdict[:-1], Verdict.VIOLATED)
    second = replace(run.runs[1], log=replace(run.runs[1].log, verdict=verdicts))
    strip = panel_of(drawn(draw_team_run(replace(run, runs=(run.runs[0], second)))), "verified")
    counts = {c.get_label(): len(c.get_offsets()) for c in strip.collections}
    assert counts == {"plan (8)": 8, "relaxed (2)": 2, "shifted (2)": 2, "not verified (1)": 1}
    ring = collection_of(strip, "not verified (1)").get_offsets()
    np.testing.assert_array_equal(ring, [[12.0, 1.0]])
    title = next(text for text in strip.get_children() if "verified" in getattr(text, "_text", ""))
    assert not title.get_window_extent().overlaps(strip.get_legend().get_window_extent())


def test_small_errors_do_not_look_large(simulation):
    """An axis of errors spans a decibel at least."""
    run = team_run(simulation, "map")
    flat = replace(run, channel=replace(run.channel, rms_db=np.full(7, 3.0)))
    low, high = panel_of(drawn(draw_team_run(flat)), "predicted map").get_ylim()
    assert high - low == pytest.approx(1.0)


def test_run_without_steps(simulation, log):
    """A run that ended where it began has no plans and no rungs to show."""
    run = team_run(simulation, "learn", 1)
    start = replace(log, **{name: getattr(log, name)[:1] for name in log.__dataclass_fields__})
    still = replace(
        run,
        runs=(replace(run.runs[0], log=start),),
        plans=((),),
        first_measurements=0,
        channel=replace(
            run.channel, **{n: getattr(run.channel, n)[:1] for n in ("rms_db", "theta_variance_db")}
        ),
    )
    entries = legend_of(drawn(draw_team_run(still)))
    assert entries == ["start", "station", "robot 0, driven"]


@pytest.mark.parametrize("task", ["track", "learn", "map"])
def test_plans_of_one_moment(simulation, belief, plan, task):
    """Units on all axes, every plan on the map, its verdict in words."""
    problem = team_problem(simulation.problem, task, 2, 0.8)
    expected = plan.positions_m[1:] + 3.0 if task == "track" else None
    figure = drawn(draw_team_plan(problem, [plan, plan], belief, expected))
    labels = labels_of(figure)
    assert {"x [m]", "y [m]", "time [s]", "power [dBm]", "P(connected) [1]"} <= labels
    assert ("distance [m]" in labels) == (task == "track")
    np.testing.assert_array_equal(
        line_of(figure.axes[0], "robot 1, planned").get_xydata(), plan.positions_m
    )
    words = "\n".join(text.get_text() for axes in figure.axes for text in axes.texts)
    assert words.count("verified, least clearance 1.62 m, least P(connected) 0.812") == 2


def test_distance_to_the_target(simulation, belief, plan):
    """Of every step's place to where the target is then; the sweet spot is a line."""
    problem = team_problem(simulation.problem, "track", 1, 0.0)
    expected = plan.positions_m[1:] + np.array([3.0, 4.0])
    free = replace(plan, certificate=replace(plan.certificate, min_clearance_m=np.inf))
    figure = drawn(draw_team_plan(problem, [free], belief, expected))
    panel = panel_of(figure, "distance")
    curve = panel.lines[0].get_xydata()
    np.testing.assert_allclose(curve[:, 1], 5.0)
    np.testing.assert_array_equal(curve[:, 0], plan.t_s[1:])
    assert list(line_of(panel, "sensor is best at 1 m").get_ydata()) == [1.0, 1.0]
    assert any("no obstacles" in text.get_text() for axes in figure.axes for text in axes.texts)
    assert list(line_of(figure.axes[0], "target as expected").get_xdata()) == list(expected[:, 0])


def test_plans_without_bound_or_target(simulation, belief, plan):
    """Only the power is left to show."""
    problem = team_problem(simulation.problem, "map", 1, 0.0)
    labels = labels_of(drawn(draw_team_plan(problem, [plan], belief, None)))
    assert labels == {"x [m]", "y [m]", "time [s]", "power [dBm]", "deviation [dB]"}


def test_pictures_are_written(simulation, belief, plan, tmp_path):
    """A picture of a run and one of plans, under the names that single robots' have."""
    run = team_run(simulation, "map", 1)
    picture_run(run, tmp_path)
    picture_solution(Solution(run.problem, 0, belief, (plan,), (Aim(),)), tmp_path)
    written = sorted(tmp_path.iterdir())
    assert [file.name for file in written] == ["plan.png", "run.png"]
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in written)


def test_the_true_way_is_seen_where_estimates_are_on_it(simulation):
    """It lies above them, and they are wider than its white edge."""
    axes = drawn(draw_team_run(team_run(simulation, "track"))).axes[0]
    way = line_of(axes, "target, true way")
    (estimates,) = (
        each for each in axes.collections if each.get_label() == "the station's estimates"
    )
    (edge,) = (
        line
        for line in axes.get_lines()
        if line is not way and np.array_equal(line.get_xydata(), way.get_xydata())
    )
    assert estimates.get_zorder() < edge.get_zorder() < way.get_zorder()
    assert np.sqrt(estimates.get_sizes()[0]) > edge.get_linewidth() > way.get_linewidth()
