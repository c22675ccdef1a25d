"""The task coverage: command, results, radio, and bad input."""

import csv
import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import shapely
from refusals import refused

import planopt
from planopt.cli import main
from planopt.coverage import ABSENT, Motion, packing_reach_m, verify_moves
from planopt.problems import problem_from_dict, problem_to_dict
from planopt.problems.tasks import problem_from
from planopt.report import draw_deployment, draw_network
from planopt.tasks.coverage import picture

SMALL = """
[problem]
schema = 1
name = "small"
task = "coverage"
[world]
bounds_m = [0, 0, 40, 30]
[agents]
start = { kind = "random", count = 12 }
speed_max_m_s = 2.0
[[events]]
name = "leak"
place_m = [12, 11]
appears_s = 8
ends_s = 40
demand = { kind = "number", agents = 3 }
[sensor]
strength = 60.0
noise_std = 0.5
scale_m = 3.0
[control]
duration_s = 200
coverage_gain_per_s = 1.0
[report]
figures = false
"""


BOUNDS = "bounds_m = [0, 0, 40, 30]"
RASTER = '[density]\nkind = "raster"\nx_m = [0, 40]\ny_m = [0, 30]\nvalues = '
RECEDING = '\n[planner]\nname = "receding"\nhorizon = 2\n'


@pytest.fixture
def written(write):
    """Write the small problem with some texts replaced and others added."""
    return partial(write, SMALL)


def test_simulate_and_check(written, tmp_path, run):
    """The event is served and given up, the folder agrees, a seed gives the same bytes again."""
    out, again = tmp_path / "out", tmp_path / "again"
    code, found = run("simulate", written(), "--seed", 3, "--out", out)
    assert code == 0 and found["outcome"] == "settled" and found["faults"] == []
    leak = found["events"][0]
    assert leak["wanted"] == leak["responding"] == leak["switches"] == 3
    assert 8.0 <= leak["detected_s"] < leak["served_s"] < 40.0 < leak["given_up_s"] <= 43.0
    assert leak["error_m"] < 1.0
    assert found["metrics"]["messages"]["assignment"] > 0
    assert found["metrics"]["messages"]["counting"] == 0
    names = {"run.json", "steps.csv", "network.csv", "events.csv", "readings.csv"}
    assert {path.name for path in out.iterdir()} == names
    assert run("check", out)[0] == 0
    run("simulate", written(), "--seed", 3, "--out", again)
    for name in names - {"run.json"}:
        assert (out / name).read_bytes() == (again / name).read_bytes()
    other = planopt.simulate(planopt.load(written()), seed=4).data
    assert other["metrics"]["cost_first"] != found["metrics"]["cost_first"]


def test_pictures(written, tmp_path, run):
    """A picture is drawn, and an animation if required."""
    file = written(("figures = false", "figures = true"), ("duration_s = 200", "duration_s = 5"))
    assert run("simulate", file, "--out", tmp_path / "out", "--animation")[0] == 4
    assert (tmp_path / "out" / "run.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "out" / "run.gif").read_bytes()[:6] == b"GIF89a"
    assert run("solve", file, "--out", tmp_path / "plan")[0] == 0
    assert (tmp_path / "plan" / "plan.png").read_bytes()[:4] == b"\x89PNG"


def test_pictures_show_the_region_itself(written):
    """The outline of a region that is not convex is drawn with its notch, not as its hull."""
    notched = "outline_m = [[0, 0], [40, 0], [40, 30], [30, 30], [30, 20], [0, 20]]"
    content = planopt.load(written(("bounds_m = [0, 0, 40, 30]", notched)))
    starts = content.starts(np.random.default_rng(0))
    panel = draw_deployment("notched", content.scene.ground, (), starts, 1.0).axes[0]
    assert [30.0, 20.0] in panel.lines[0].get_xydata().tolist()
    assert len(panel.collections[1].get_offsets()) == len(starts)


def test_saved_problems_need_no_other_files(written, tmp_path):
    """A problem written out in full, with a raster from a file, builds the same run."""
    cells = "\n".join(f"{x},{y},{1 + x}" for y in (5, 15, 25) for x in (5, 15, 25, 35))
    (tmp_path / "weights.csv").write_text(f"x_m,y_m,density\n{cells}\n")
    more = '\n[density]\nkind = "raster"\nfile = "weights.csv"\n'
    problem = planopt.load(written(more=more))
    (tmp_path / "weights.csv").unlink()
    again = problem_from(
        json.loads(json.dumps(problem.tables())), folder=tmp_path / "nowhere", file=None
    )
    first, second = (planopt.simulate(each, seed=1).data["metrics"] for each in (problem, again))
    assert first == second
    assert first["cost_first"] > 10.0 * planopt.simulate(planopt.load(written()), seed=1).data[
        "metrics"
    ]["cost_first"]  # fmt: skip


def cell(file: str, column: str, number: int, new: str):
    def change(folder: Path) -> None:
        rows = list(csv.reader((folder / file).read_text().splitlines()))
        rows[number][rows[0].index(column)] = new
        (folder / file).write_text("\n".join(",".join(row) for row in rows) + "\n")

    return change


@pytest.mark.parametrize(
    ("changes", "more"),
    [
        ((("[12, 11]", "[50, 11]"),), ""),
        ((("ends_s = 40", "ends_s = 7"),), ""),
        ((("scale_m = 3.0", "scale_m = 0.0"),), ""),
        (((BOUNDS, BOUNDS + "\nclearance_m = -1.0"),), ""),
        ((("agents = 3 }", "agents = 3 }\nvelocity_m_s = [1, 0]"),), ""),
        ((('kind = "random", count = 12', 'kind = "list", places_m = [[1, 1], [50, 1]]'),), ""),
        (((BOUNDS, "outline_m = [[0, 0], [40, 30], [40, 0], [0, 30]]"),), ""),
        (((BOUNDS, BOUNDS + '\nobstacles = [{ name = "wall", polygon = '
           "[[20, -1], [22, -1], [22, 31], [20, 31]] }]"),), ""),
        ((), RASTER + "[[1, -1], [1, 1]]"),
        ((), RASTER + "[[0, 0], [0, 0]]"),
        ((), '[density]\nkind = "gaussians"\nbumps = [{ weight = 0, mean_m = [1, 1], std_m = 1 }]'),
        ((('kind = "number", agents = 3', 'kind = "accuracy", accuracy_m = 1e-4'),), ""),
        ((('"number", agents = 3', '"number", agents = 13'),), ""),
        ((('"number", agents = 3', '"cap", share = 0.5, most = 3, remaining = 12'),), ""),
        ((('"number", agents = 3', '"table", steps = [{ at_least = 2, respond = 3 }]'),), ""),
        ((("count = 12", "count = 1"), ("agents = 3 }", "agents = 1 }")),
         '[[events]]\nname = "two"\nplace_m = [3, 3]\nappears_s = 9\n'
         'demand = { kind = "number", agents = 1 }'),
        ((("[sensor]\nstrength = 60.0\nnoise_std = 0.5\nscale_m = 3.0\n", ""),), ""),
        ((("coverage_gain_per_s = 1.0", "coverage_gain_per_s = 1.5"),), ""),
        ((), "[[changes]]\nagents = [12]"),
        ((), "[[changes]]\nagents = [0,1,2,3,4,5,6,7,8,9,10,11]\nleaves_s = 20"),
        ((("bounds_m = [0, 0, 40, 30]", "bounds_m = [40, 0, 0, 30]"),), ""),
        ((('kind = "random", count = 12', 'kind = "list", places_m = [[5, 5], [9, 9], [9, 8]]'),
          ("speed_max_m_s = 2.0", "body_radius_m = 0.5")), RECEDING),
        ((('kind = "random", count = 12', 'kind = "list", places_m = [[5, 5], [9, 9], [9, 0.2]]'),
          ("speed_max_m_s = 2.0", "body_radius_m = 0.5")), RECEDING),
        ((("speed_max_m_s = 2.0", "body_radius_m = 4"),), RECEDING),
        ((("speed_max_m_s = 2.0", "body_radius_m = 0.5"),), ""),
    ],
)  # fmt: skip
def test_bad_input_names_its_key(changes, more, written):
    """Each mistake gets one error with its key, and no run."""
    with refused():
        planopt.load(written(*changes, more=more))


def test_exactly_the_wanted_agents_and_a_centroidal_rest(written):
    """While the event lasts, the nearest agents stand at it, and all others on their centroids."""
    changes = (("ends_s = 40\n", ""), ("duration_s = 200", "duration_s = 900"))
    content = planopt.load(written(*changes))
    for seed in range(3):
        done = planopt.simulate(content, seed=seed).value
        assert done.settled
        at_event = np.linalg.norm(done.positions_m[-1] - (12.0, 11.0), axis=1) < 1.0
        assert at_event.sum() == 3
        assert (done.states[-1][at_event] == 0).all()
        assert done.residuals_m[-1] <= content.scene.settled_m


def test_receding_horizon_within_limits(written, tmp_path, run):
    """Double integrators and unicycles respond to the event, and their folders are verified."""
    for number, limit in enumerate(("acceleration_max_m_s2 = 0.7", "turn_rate_max_rad_s = 0.8")):
        file = written(
            ("speed_max_m_s = 2.0", f"speed_max_m_s = 2.0\n{limit}"),
            ("ends_s = 40", "ends_s = 25"),
            ("duration_s = 200", "duration_s = 28"),
            more='\n[planner]\nname = "receding"\nhorizon = 4\n',
        )
        out = tmp_path / str(number)
        _, found = run("simulate", file, "--out", out)
        assert found["faults"] == [] and found["planner"] == "receding"
        assert found["events"][0]["responding"] == 3
        assert found["metrics"]["cost_last"] < 0.7 * found["metrics"]["cost_first"]
        assert run("check", out)[0] == 0
        cell("steps.csv", "vx_m_s" if number == 0 else "heading_rad", 9, "1.9")(out)
        assert run("check", out)[0] == 3
    with refused():
        planopt.simulate(planopt.load(file), planner="law")


@pytest.mark.parametrize("limit", ["acceleration_max_m_s2", "turn_rate_max_rad_s"])
def test_slow_agents_are_not_settled_at_the_start(limit):
    """A run does not end while agents far from their targets speed up from rest, or turn."""
    tables = problem_to_dict(planopt.load("coverage_unicycles"))
    del tables["agents"]["turn_rate_max_rad_s"]
    tables["agents"][limit] = 0.1
    found = planopt.simulate(problem_from_dict(tables), seed=0).data
    assert found["faults"] == []
    assert found["metrics"]["cost_last"] < 0.2 * found["metrics"]["cost_first"]


BODIES = (
    ("count = 12", "count = 12, within_m = [0, 0, 14, 14]"),
    ("speed_max_m_s = 2.0", "speed_max_m_s = 2.0\nbody_radius_m = 0.6"),
    ("agents = 3", "agents = 5"),
    ("duration_s = 200", "duration_s = 60"),
)


@pytest.mark.parametrize("inert", [False, True])
def test_no_two_bodies_touch(inert, written, tmp_path, run):
    """Bodies are apart at all times of all moves, and crowd around the event as near as they can.

    An agent that is to join in the crowd waits until there is room.
    """
    changes = list(BODIES)
    if inert:
        changes.append(("body_radius_m", "acceleration_max_m_s2 = 0.7\nbody_radius_m"))
    content, middle = planopt.load(written(*changes, more=RECEDING)), np.array([12.0, 11.0])
    # The last agent would join at the event, where the others stand.
    starts = np.vstack([content.starts(np.random.default_rng(2)), middle]).tolist()
    listed = f'kind = "list", places_m = {starts}'
    changes[0] = ('kind = "random", count = 12', listed)
    file = written(*changes, more="[[changes]]\nagents = [12]\njoins_s = 30\n" + RECEDING)
    code, found = run("simulate", file, "--out", tmp_path / "out")
    assert code in (0, 4) and found["faults"] == []
    assert 8.0 < found["events"][0]["served_s"] < 30.0
    assert run("check", tmp_path / "out")[0] == 0
    done = planopt.simulate(planopt.load(file)).value
    joined = int((done.states[:, 12] != ABSENT).argmax())
    assert 40 < joined < len(done.states)
    step = np.linspace(0.0, 1.0, 33)[:, None, None]
    for now in range(len(done.states)):
        who = done.states[now] != ABSENT
        here, after = done.positions_m[now, who], done.positions_m[now + 1, who]
        first = done.velocities_m_s[now, who] if inert else after - here
        places = here + step * first + step**2 * (after - here - first)
        gaps = np.linalg.norm(places[:, :, None] - places[:, None], axis=3)
        assert gaps[:, ~np.eye(who.sum(), dtype=bool)].min() > 1.2
        assert (places > 0.6 - 1e-6).all() and (places < np.array([39.4, 29.4]) + 1e-6).all()
    team = done.positions_m[38, done.states[38] == 0]
    away_m = np.sort(np.linalg.norm(team - middle, axis=1))
    # Five discs fit in a circle of 2.7013 radii at best (Graham 1968): centres at 1.7013.
    assert len(team) == 5 and 1.7013 * 0.6 - 0.1 < away_m[-1] <= 1.3 * 1.7013 * 0.6
    with refused():
        planopt.simulate(planopt.load(file), planner="law")


def test_bodies_in_place_hold_shells():
    """A body more than fill some shells of a hexagonal packing needs one more."""
    for shells in range(1, 5):
        full = 1 + 3 * shells * (shells + 1)
        assert packing_reach_m(full, 0.5) == shells + 1.0
        assert packing_reach_m(full + 1, 0.5) == shells + 2.0
    assert packing_reach_m(9, 0.0) == 0.0 and packing_reach_m(1, 0.5) == 0.5


def test_compare_horizons_paired(written, tmp_path, run):
    """Settings are paired by seed; with one step receding is the law, with three it costs less."""
    file = written(("duration_s = 200", "duration_s = 12"), ("speed_max_m_s = 2.0\n", ""))
    out = tmp_path / "out"
    code, found = run(
        "compare", file, "--planners", "law,receding", "--horizons", "1,3", "--seeds", "2",
        "--out", out,
    )  # fmt: skip
    assert code == 4
    assert {row["verified_rate"] for row in found["rows"]} == {1.0}
    rows = [row for row in found["rows"] if row["metric"] == "cost_mean"]
    assert [(row["planner"], row["horizon"]) for row in rows] == [
        ("law", 1),
        ("receding", 1),
        ("receding", 3),
    ]
    ratios = [row["paired_ratio"] for row in rows]
    assert ratios[:2] == pytest.approx([1.0, 1.0], abs=1e-6) and ratios[2] < 1.0
    one = planopt.simulate(planopt.load(file), seed=1).data["metrics"]
    mine = next(each for each in found["runs"] if each["seed"] == 1 and each["planner"] == "law")
    mine = mine["metrics"]
    assert mine["cost_mean"] == pytest.approx(one["cost_mean"])
    assert mine["path_m"] == pytest.approx(one["path_m"])


def _links_are_drawn(kept, lost):
    """Pictures show a tree to the station, and who has none by the verifier's own reckoning."""
    content, radio = kept.problem, kept.problem.radio
    pictures = [picture(each) for each in (kept, lost)]
    station = radio.stations_m[0]
    for each in pictures:
        here = each.run.positions_m[29]
        links, lonely = each.links(29)
        assert len(links) + len(lonely) == len(here)
        reached, ends = [station], links.tolist()
        while ends:
            # Every link leads from an agent to one that is nearer to the station in the tree.
            grown = [a for a, b in ends if any(np.allclose(b, one) for one in reached)]
            assert grown
            reached += grown
            ends = [pair for pair in ends if pair[0] not in grown]
        still, free = Motion.at_rest(here), shapely.box(0, 0, 200, 150)
        alone = verify_moves(free, still, still, content.config.limits, radio)
        assert np.array_equal(lonely, here[[fault.agent for fault in alone]])
    assert len(pictures[0].links(29)[1]) == 0 < len(pictures[1].links(29)[1])
    figure = draw_network(pictures[1])
    labels = {each.get_label() for panel in figure.axes for each in panel.collections}
    assert {"base station", "radio link", "disconnected agent"} <= labels


def test_radio_is_kept_where_the_law_loses_it():
    """Plans keep every agent's links to the station; the laws alone do not, and report it."""
    content = planopt.load("coverage_radio")
    content = replace(content, scene=replace(content.scene, duration_s=30.0))
    kept, by_law = planopt.simulate(content), planopt.simulate(content, planner="law")
    assert kept.data["faults"] == []
    lost = by_law.data["faults"]
    assert lost and all("fault of radio" in each for each in lost)
    _links_are_drawn(kept, by_law)
    with refused() as caught:
        away = content.config.radio.model_copy(update={"stations_m": [(200.0, 150.0)]})
        replace(content, config=content.config.model_copy(update={"radio": away})).starts(
            np.random.default_rng(0)
        )
    assert caught.value.key == "agents.start"


def test_solve_and_check(written, tmp_path, run):
    """The deployment is no worse than Lloyd's, above its bound, and verified from its file."""
    out = tmp_path / "out"
    code, found = run("solve", written(), "--seed", 2, "--out", out)
    assert code == 0 and found["verdict"] == "verified" and found["sense"] == "min"
    assert 0.0 < found["bound"] < found["objective"] <= min(found["start_costs"]) * (1 + 1e-9)
    late = (("appears_s = 8\n", "appears_s = 500\n"), ("ends_s = 40", "ends_s = 600"))
    alone = planopt.simulate(planopt.load(written(*late)), seed=2)
    assert found["objective"] <= alone.data["metrics"]["cost_last"] * 1.001
    assert run("check", out)[0] == 0


PROBLEM = """
[problem]
schema = 1
name = "surveyed"
task = "coverage"
[world]
bounds_m = [0, 0, 90, 60]
[agents]
start = { kind = "random", count = 8, within_m = [5, 5, 25, 25] }
speed_max_m_s = 3.0
[radio]
stations_m = [[10, 10]]
p_min = 0.95
k_pl_db = -30.0
n_pl = 3.0
deviation_db = 4.0
threshold_dbm = -78.0
[control]
duration_s = 16
coverage_gain_per_s = 0.8
[planner]
name = "receding"
horizon = 3
[report]
figures = false
"""
SIMULATED = "[[radio.survey]]\ncount = 80\nseed = 3\n"


def log(folder: Path, *more: str) -> str:
    """Write a log of 60 powers with a wall's shadow beyond x = 50; its table."""
    rng = np.random.default_rng(4)
    places = rng.random((60, 2)) * (90.0, 60.0)
    away = np.linalg.norm(places - 10.0, axis=1)
    power = -30.0 - 30.0 * np.log10(away) - 25.0 * (places[:, 0] > 50.0) + rng.normal(size=60)
    rows = [f"{x:.2f},{y:.2f},{p:.1f}" for (x, y), p in zip(places, power, strict=True)]
    (folder / "log.csv").write_text("\n".join(("x_m,y_m,power_dbm", *rows, *more)) + "\n")
    return '[[radio.survey]]\nfile = "log.csv"\n'


def test_surveyed_links_are_kept_and_verified(tmp_path, capsys):
    """No move breaks the learnt links, the folder is verified, and the laws lose them."""
    file = tmp_path / "problem.toml"
    file.write_text(PROBLEM + SIMULATED)
    out = tmp_path / "out"
    assert main(["simulate", str(file), "--out", str(out), "--json"]) in (0, 4)
    found = json.loads(capsys.readouterr().out)
    assert found["faults"] == []
    assert found["metrics"]["cost_last"] < 0.6 * found["metrics"]["cost_first"]
    assert main(["check", str(out)]) == 0
    lost = planopt.simulate(planopt.load(file), planner="law").data["faults"]
    assert lost and all("fault of radio" in each for each in lost)


def test_a_log_teaches_where_links_fail(tmp_path):
    """Direct links are trusted before the wall only, and a saved problem needs no log."""
    table = log(tmp_path)
    (tmp_path / "problem.toml").write_text(PROBLEM + table)
    problem = planopt.load(tmp_path / "problem.toml")
    mapped = problem.station_map
    before, behind = np.array([[30.0, 20.0]]), np.array([[70.0, 20.0]])
    assert mapped.near(before, before)[0, 0] < 0.4
    assert mapped.near(behind, behind)[0, 0] > 0.9
    tables = json.loads(json.dumps(problem.tables()))
    (tmp_path / "log.csv").unlink()
    again = problem_from(tables, folder=tmp_path / "nowhere", file=None)
    np.testing.assert_array_equal(again.station_map.failures, mapped.failures)


@pytest.mark.parametrize(
    "table",
    [
        SIMULATED + SIMULATED,
        "[[radio.survey]]\n",
        '[[radio.survey]]\nfile = "nowhere.csv"\n',
        "[[radio.survey]]\nplaces_m = [[1, 1]]\npower_dbm = []\n",
        SIMULATED + "decorrelation_m = 0.2\n",
        "log",
    ],
)
def test_wrong_surveys_are_named(table, tmp_path):
    """Each mistake gets one error with its key."""
    if table == "log":
        table = log(tmp_path, "1,2,abc")
    (tmp_path / "problem.toml").write_text(PROBLEM + table)
    with refused():
        planopt.load(tmp_path / "problem.toml")
