"""Figures of plans and runs: units, curves and marks that equal the data, certificates."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from apart_scene import apart_problem
from artists import collection_of, drawn, labels_of, legend_of, line_of, panel_of
from teams import team_problem, team_run

from planopt import ConnectivityRule, MovingObstacle, Solution, Verdict, load, simulate, solve
from planopt.objectives.terms.term import Aim
from planopt.planning.certificate import RuleResult
from planopt.report import draw_run, draw_run_series, draw_solution
from planopt.report.motion_figures import WORDS_LINES
from planopt.report.motion_words import plan_in_words, proof_in_words
from planopt.report.panel import BAND_Z
from planopt.tasks.motion import TASK
from planopt.world import centres_at

MAP, POWER, CHANCE = {"x [m]", "y [m]"}, "power [dBm]", "P(connected) [1]"
DISC = "moving obstacle (later: paler)"


def test_units_of_plan_run_and_series(solution, simulation):
    """All axes of the figures of one robot to a goal have units."""
    plan = drawn(draw_solution(solution))
    assert labels_of(plan) == MAP | {"time [s]", POWER, CHANCE, "P(connected) [1] (line: p_min)"}
    assert labels_of(drawn(draw_run(simulation))) == MAP | {"true power [dBm] (line: threshold)"}
    assert labels_of(drawn(draw_run_series(simulation))) == {
        "time [s]", POWER, CHANCE, "step time [ms]"
    }  # fmt: skip


def test_map_of_a_plan(solution, plan, problem):
    """The path has the plan's waypoints inside the window; the outline keeps the clearance."""
    figure = draw_solution(solution)
    axes = figure.axes[0]
    path = line_of(axes, "rover, planned")
    np.testing.assert_array_equal(path.get_xydata(), plan.positions_m)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert (plan.positions_m > (left, bottom)).all() and (plan.positions_m < (right, top)).all()
    assert right - left == pytest.approx(10 * 2.0)  # ten longest steps of 2 m
    assert axes.get_legend() is None and "rover, planned" in legend_of(figure)
    (beyond,) = [text.get_text() for text in axes.texts if "station" in text.get_text()]
    away = np.array(problem.stations[0].site.position_m)
    away = away - np.clip(away, (left, bottom), (right, top))
    assert beyond == f"station {np.hypot(*away):.0f} m"
    (inset,) = axes.child_axes
    assert inset.get_xlim() == (0.0, 100.0)
    frame = inset.lines[-1].get_xydata()
    np.testing.assert_allclose(frame[[0, 2]].T, [axes.get_xlim(), axes.get_ylim()])
    far = replace(plan, positions_m=plan.positions_m * [4.0, 4.0])
    axes = draw_solution(replace(solution, plans=(far,))).axes[0]
    corners = np.concatenate(collection_of(axes, "clearance of 1.5 m").get_segments())
    obstacles = shapely.union_all([part.polygon for part in problem.workspace.obstacles])
    np.testing.assert_allclose(shapely.distance(shapely.points(corners), obstacles), 1.5, atol=1e-6)


def test_curves_of_a_plan(solution, plan):
    """Power with its band and threshold, connectivity with its bound and relaxed step."""
    figure = draw_solution(solution)
    power = panel_of(figure, "predicted power")
    chance = panel_of(figure, "planned P(connected)")
    np.testing.assert_array_equal(
        power.lines[0].get_xydata(), np.stack([plan.t_s, plan.mean_dbm], axis=1)
    )
    corners = collection_of(power, "80 % band").get_paths()[0].vertices
    assert corners[:, 1].max() == pytest.approx((plan.mean_dbm + BAND_Z * plan.deviation_db).max())
    assert line_of(power, "threshold").get_ydata()[0] == -72.0
    np.testing.assert_array_equal(chance.lines[0].get_ydata(), plan.connectivity)
    assert line_of(chance, "p_min = 0.8").get_ydata()[0] == 0.8
    relaxed = collection_of(chance, "P(connected) below p_min").get_offsets()
    np.testing.assert_allclose(relaxed, [[plan.t_s[3], plan.connectivity[3]]])


def test_certificate_in_words(solution):
    """The certificate's numbers stand in the figure; too many words end in dots."""

    def words_of(solution):
        figure = draw_solution(solution)
        return "\n".join(text.get_text() for axes in figure.axes[1:] for text in axes.texts)

    words = words_of(solution)
    for number in ("1.625 m", "0.812", "2.5e-09", "3.5e-07", "101.2", "103.5", "0.75 dB"):
        assert number in words
    proof = solution.plan.certificate
    rule = RuleResult("each_step", 2.0, 3.0, "steps", "p_min at each required step", 0.5)
    parts = replace(proof, kkt_residual=None, relaxed_steps=(), rule=rule, reasons=("one",))
    words = words_of(replace(solution, plans=(replace(solution.plan, certificate=parts),)))
    assert "not refined" in words and "missed" not in words and words.endswith("one")
    assert "connectivity rule each_step: 2 steps" in words.replace("\n    ", " ")
    reasons = tuple(f"reason {number}" for number in range(30))
    plan = replace(solution.plan, certificate=replace(proof, reasons=reasons))
    words = words_of(replace(solution, plans=(plan,)))
    assert len(words.splitlines()) == WORDS_LINES and words.endswith("...")


@pytest.mark.parametrize(
    ("form", "more", "required"),
    [
        ("joint", {}, False),
        ("data", {"data_mbit": 10.0, "deadline_s": 100.0, "rate_mbit_s": 1.0}, False),
        ("outage", {"outage_max_s": 10.0}, True),
    ],
)
def test_a_bound_is_required_of_single_steps(plan, problem, form, more, required):
    """A requirement on all steps together says nothing of the least of them."""
    limits = replace(problem.constraints, rule=ConnectivityRule(form, **more))
    problem = replace(problem, constraints=limits)
    words = "\n".join([*plan_in_words(problem, plan), *proof_in_words(problem, plan)])
    assert (", P(connected) 0.8" in words) == required


def test_map_of_a_run(simulation, plan, log, measurements):
    """The layer is the true power; path, plan, relaxed steps and measurements are the data's."""
    figure = drawn(draw_run(simulation))
    axes = figure.axes[0]
    assert axes.get_title(loc="left") == "step limit: six steps"
    np.testing.assert_array_equal(axes.images[0].get_array(), simulation.truths[0].raster.values)
    good = collection_of(axes, "driven, connected")
    lost = collection_of(axes, "driven, not connected")
    np.testing.assert_array_equal(lost.get_segments(), [log.positions_m[1:3]])
    np.testing.assert_array_equal(good.get_segments()[0], log.positions_m[:2])
    np.testing.assert_array_equal(good.get_segments()[1], log.positions_m[2:])
    # Dashes and lightness tell the two apart without colour.
    assert lost.get_linestyle()[0][1] is not None and good.get_linestyle()[0][1] is None
    np.testing.assert_array_equal(line_of(axes, "rover, planned").get_xydata(), plan.positions_m)
    for label, expected in (
        ("P(connected) below p_min", log.positions_m[[3]]),
        ("measured before the run", measurements.positions_m[:24]),
        ("measured during the run", measurements.positions_m[24:]),
    ):
        np.testing.assert_array_equal(collection_of(axes, label).get_offsets(), expected)
    connected = replace(simulation.run, log=replace(log, connected=np.ones_like(log.connected)))
    assert "driven, not connected" not in legend_of(
        drawn(draw_run(replace(simulation, runs=(connected,))))
    )


def test_series_of_a_run(simulation, log):
    """Power, connection, connectivity and step times are the log's."""
    figure = drawn(draw_run_series(simulation))
    power = panel_of(figure, "received power")
    predicted = line_of(power, "predicted one step ahead").get_xydata()
    np.testing.assert_array_equal(predicted, np.stack([log.t_s, log.predicted_dbm], axis=1))
    np.testing.assert_array_equal(line_of(power, "true").get_ydata(), log.true_dbm)
    rows = panel_of(figure, "true connection (83.3 % of steps")
    lost = [each.get_offsets() for each in rows.collections if len(each.get_offsets()) == 1]
    np.testing.assert_array_equal(np.concatenate(lost), [[4.0, 0.0]])
    chance = panel_of(figure, "one step ahead")
    np.testing.assert_array_equal(chance.lines[0].get_ydata(), log.connectivity)
    relaxed = collection_of(chance, "P(connected) below p_min").get_offsets()
    np.testing.assert_allclose(relaxed, [[log.t_s[3], log.connectivity[3]]])
    times = panel_of(figure, "planning time")
    plans = collection_of(times, "plan (4)").get_offsets()
    np.testing.assert_allclose(plans, [[2.0, 20.0], [4.0, 30.0], [10.0, 50.0], [12.0, 20.0]])
    assert times.get_yscale() == "log"


def test_run_without_steps(simulation, log):
    """A run that ended at its start has neither plans nor step times."""
    start = replace(log, **{name: getattr(log, name)[:1] for name in log.__dataclass_fields__})
    ended = replace(
        simulation, runs=(replace(simulation.run, log=start),), plans=((),), first_measurements=30
    )
    absent = {"rover, planned", "P(connected) below p_min", "measured during the run"}
    assert not absent & set(legend_of(drawn(draw_run(ended))))
    times = panel_of(drawn(draw_run_series(ended)), "planning time")
    assert [text.get_text() for text in times.texts] == ["no step was released"]
    team = team_run(simulation, "learn", 1)
    knowledge = {name: getattr(team.channel, name)[:1] for name in ("rms_db", "theta_variance_db")}
    ended = replace(
        team,
        runs=(replace(team.runs[0], log=start),),
        plans=((),),
        first_measurements=0,
        channel=replace(team.channel, **knowledge),
    )
    assert set(legend_of(drawn(draw_run(ended)))) == {"start", "station", "robot_0, driven"}


@pytest.mark.parametrize("robots", [1, 3])
def test_robots_of_a_team(simulation, robots):
    """Tracks and plans are the data's; no two robots look the same."""
    run = team_run(simulation, "learn", robots)
    figure = drawn(draw_run(run))
    looks = set()
    for one, plans in zip(run.runs, run.plans, strict=True):
        track = line_of(figure.axes[0], f"{one.robot}, driven")
        plan = line_of(figure.axes[0], f"{one.robot}, planned")
        np.testing.assert_array_equal(track.get_xydata(), one.log.positions_m)
        np.testing.assert_array_equal(plan.get_xydata(), plans[-1].positions_m[1:])
        assert (track.get_color(), track.get_marker()) == (plan.get_color(), plan.get_marker())
        looks.add((track.get_color(), track.get_marker()))
    assert len(looks) == robots and len(legend_of(figure)) == 3 + 2 * robots


def test_target_and_its_estimates(simulation):
    """True path above the estimates, and the trace marked by whether a packet arrived."""
    run = team_run(simulation, "track")
    figure = drawn(draw_run(run))
    ground, curve = figure.axes[0], panel_of(figure, "uncertainty of the target")
    path = line_of(ground, "target, true path")
    estimates = collection_of(ground, "station's estimates")
    np.testing.assert_array_equal(path.get_xydata(), run.target.true_m)
    np.testing.assert_array_equal(estimates.get_offsets(), run.target.station_mean_m)
    assert estimates.get_zorder() < path.get_zorder()
    lost = collection_of(curve, "no packet arrived").get_offsets()
    np.testing.assert_allclose(lost, [[4.0, run.target.station_variance_m2[2]]])
    assert len(collection_of(curve, "packets arrived").get_offsets()) == 5


def test_fallbacks_and_verdicts(simulation):
    """Every released plan has the mark of its fallback; an unverified one has a circle."""
    run = team_run(simulation, "learn", 2)
    verdicts = (*run.runs[1].log.verdict[:-1], Verdict.VIOLATED)
    second = replace(run.runs[1], log=replace(run.runs[1].log, verdict=verdicts))
    strip = panel_of(drawn(draw_run(replace(run, runs=(run.runs[0], second)))), "verified")
    counts = {each.get_label(): len(each.get_offsets()) for each in strip.collections}
    assert counts == {"plan (8)": 8, "relaxed (2)": 2, "shifted (2)": 2, "not verified (1)": 1}
    circle = collection_of(strip, "not verified (1)").get_offsets()
    np.testing.assert_array_equal(circle, [[12.0, 1.0]])


@pytest.mark.parametrize("task", ["track", "learn", "map"])
def test_plans_of_a_team(simulation, belief, plan, task):
    """Every plan on the map, its verdict in words, the distance to the expected target."""
    problem = team_problem(simulation.problem, task, 2, 0.8)
    target_m = plan.positions_m[1:] + np.array([3.0, 4.0]) if task == "track" else None
    plans = tuple(replace(plan, robot=robot.name) for robot in problem.robots)
    figure = drawn(draw_solution(Solution(problem, 0, belief, plans, (Aim(target_m),) * 2)))
    labels = labels_of(figure)
    assert MAP | {"time [s]", POWER, CHANCE} <= labels
    assert ("distance [m]" in labels) == (task == "track")
    np.testing.assert_array_equal(
        line_of(figure.axes[0], "robot_1, planned").get_xydata(), plan.positions_m
    )
    words = "\n".join(text.get_text() for axes in figure.axes for text in axes.texts)
    assert words.count("verified; refined path; solver converged") == words.count("0.812") == 2
    if target_m is not None:
        curve = panel_of(figure, "distance").lines[0].get_xydata()
        np.testing.assert_allclose(curve, np.stack([plan.t_s[1:], np.full(4, 5.0)], axis=1))


def test_pictures_are_written(simulation, solution, tmp_path):
    """A run and a solution are saved under the same names for every number of robots."""
    for value in (team_run(simulation, "map", 1), solution):
        TASK.explained(value).draw(tmp_path)
    names = {"plan.png", "run.png", "belief.png"}
    assert {file.name for file in tmp_path.iterdir()} == names
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in names)


def discs(panel):
    """Centres and radii of the drawn moving obstacles."""
    boxes = [path.get_extents() for path in collection_of(panel, DISC).get_paths()]
    return [((box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2, box.width / 2) for box in boxes]


def test_moving_obstacles_and_distances():
    """Discs of true size where the obstacle was; the least distances equal the metrics."""
    run = simulate(apart_problem([(10, 15), (14, 15)], max_steps=4, horizon=3), seed=0)
    figure = drawn(draw_run(run))
    (cart,) = run.problem.workspace.moving
    expected = [
        (*centre, cart.radius_m) for centre in centres_at(cart, run.runs[0].log.t_s).tolist()
    ]
    np.testing.assert_allclose(discs(figure.axes[0]), expected, atol=1e-3)
    panel = panel_of(figure, "minimum distance")
    assert min(line_of(panel, "two robots").get_ydata()) == run.metrics["min_separation_m"]
    away = line_of(panel, "moving obstacle").get_ydata()
    assert min(away) == run.metrics["min_moving_clearance_m"]
    levels = [line.get_ydata()[0] for line in panel.lines if line.get_linestyle() == "--"]
    assert levels == [3.0, 0.5]


def test_moving_obstacles_only_where_there_are_some():
    """A plan shows moving obstacles only if the workspace has them."""
    problem = load("open_field")
    solved = solve(problem, horizon=2)
    assert DISC not in legend_of(drawn(draw_solution(solved)))
    cart = MovingObstacle("cart", 1.0, (0.0,), ((30.0, 40.0),), (0.1, 0.1))
    moving = replace(problem, workspace=replace(problem.workspace, moving=(cart,)))
    figure = drawn(draw_solution(replace(solved, problem=moving)))
    assert DISC in legend_of(figure) and len(discs(figure.axes[0])) == 3
