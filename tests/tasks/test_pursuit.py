"""The task pursuit: command, results, and bad input."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import shapely
from refusals import refused

import planopt
from planopt import NoPlanError
from planopt.problems.library import library_folder

NAMES = ("pursuit_static", "pursuit_fleeing", "pursuit_obstacles", "pursuit_several")


@pytest.fixture
def written(write):
    """Write a library problem without pictures and with some texts replaced."""

    def write_library(name: str, *changes: tuple[str, str]) -> Path:
        text = (library_folder() / f"{name}.toml").read_text()
        return write(text, *changes, more="\n[report]\nfigures = false\n")

    return write_library


@pytest.mark.parametrize("name", NAMES)
def test_library_problems(name, written, tmp_path, run):
    """Everybody is caught, the folder agrees with itself, the same seed gives the same run."""
    out = tmp_path / "out"
    code, found = run("simulate", written(name), "--seed", 3, "--out", out)
    assert code == 0 and found["outcome"] == "captured" and found["faults"] == []
    assert sum(found["rungs"].values()) == found["metrics"]["steps"]
    assert found["verified_rate"] == (None if name == "pursuit_obstacles" else 1.0)
    assert found["step_s"]["p50"] <= found["step_s"]["p95"] <= found["step_s"]["max"]
    assert found["capture_time_s"] == max(each["capture_time_s"] for each in found["evaders"])
    assert run("check", out)[0] == 0
    assert {path.name for path in out.iterdir()} == {"run.json", "steps.csv", "records.csv"}
    again = planopt.simulate(planopt.load(written(name)), seed=3).data
    assert again["capture_time_s"] == found["capture_time_s"]


def test_capture_within_the_guarantee(written):
    """One pursuer and one evader: caught within the promised time, stages under their bounds."""
    for seed in range(5):
        found = planopt.simulate(planopt.load(written("pursuit_fleeing")), seed=seed).data
        assert found["guarantee"]["applies"]
        for each in found["guarantee"]["theorems"].values():
            assert each["holds"] and each["capture"]["holds"]
            assert found["capture_time_s"] <= each["capture_time_s"]
            assert each["largest_share_of_bound"] is None or each["largest_share_of_bound"] <= 1.0


def test_pictures(tmp_path, run):
    """A picture and an animation are drawn in addition to the tables."""
    assert run("simulate", "pursuit_static", "--animation", "--out", tmp_path)[0] == 0
    assert (tmp_path / "run.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "run.gif").read_bytes()[:6] == b"GIF89a"


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("pursuit_fleeing", ("endless = true", "endless = false"), "network.endless"),
        ("pursuit_static", ("640, 640]", "650, 640]"), "leaves the mote grid"),
        ("pursuit_static", ("[40, 60]", "[40, 700]"), "pursuers[0].start_m"),
        (
            "pursuit_obstacles",
            ("start_m = [20, 20]", "start_m = [100, 100]"),
            "no free start position",
        ),
        ("pursuit_fleeing", ('kind = "fleeing"', 'kind = "flying"'), "evaders[0].behaviour.kind"),
        ("pursuit_fleeing", ("frame_s = 0.1", "frame_s = inf"), "network.frame_s"),
        ("pursuit_fleeing", ("step_s = 0.2", "stepp_s = 0.2"), "did you mean step_s"),
    ],
)
def test_bad_input(name, change, words, written, run):
    code, found = run("simulate", written(name, change))
    assert code == 2 and words in found["error"]


@pytest.mark.parametrize("planner", ["drive", "receding"])
def test_evader_faster_than_its_pursuer(planner, written, run, tmp_path):
    """It is simulated, and every theorem says that it does not apply; a guarantee is refused."""
    file = written("pursuit_fleeing", ("speed_max_m_s = 5.0", "speed_max_m_s = 1.5"))
    code, found = run("simulate", file)
    assert code == 4 and "evader's speed below the pursuer's" in found["reason"]
    text = "\n".join(line for line in file.read_text().split("\n") if "guarantee" not in line)
    file.write_text(text.replace("capture_radius_m", "max_steps = 50\ncapture_radius_m"))
    out = tmp_path / "run"
    code, found = run("simulate", file, "--planner", planner, "--out", out)
    assert code == 4 and found["outcome"] == "step_limit" and found["faults"] == []
    assert not any(each["holds"] for each in found["guarantee"]["theorems"].values())
    assert run("check", out)[0] == 0


@pytest.mark.parametrize("planner", ["drive", "receding"])
def test_unicycle_and_foresight_among_obstacles(planner, written, run, tmp_path):
    """The unicycle turns on the spot at corners and keeps the clearance between steps too."""
    file = written(
        "pursuit_obstacles",
        ("speed_max_m_s = 4.0", "speed_max_m_s = 4.0\nturn_rate_max_rad_s = 1.0"),
        ('"wandering" }', '"foresighted", horizon = 3, plan_step_s = 1.0 }'),
    )
    out = tmp_path / "run"
    code, found = run("simulate", file, "--planner", planner, "--out", out)
    assert code == 0 and found["outcome"] == "captured" and found["faults"] == []
    assert run("check", out)[0] == 0
    table = pd.read_csv(out / "steps.csv")
    obstacles = [each.polygon for each in planopt.load(file).obstacles]
    for _, rows in table.groupby("robot"):
        path = shapely.LineString(rows[["x_m", "y_m"]].to_numpy())
        assert min(path.distance(each) for each in obstacles) >= 2.0 - 1e-6
    own = table[table.robot == "pursuer"]
    turned = np.abs(np.angle(np.exp(1j * np.diff(own.heading_rad))))
    moved = np.hypot(np.diff(own.x_m), np.diff(own.y_m))
    assert turned.max() > 0.1
    assert (turned / 1.0 + moved / 4.0 <= 0.2 * (1 + 1e-9)).all()


def test_lost_records_void_the_guarantee(written, run):
    """The theorems assume that no record is lost."""
    file = written("pursuit_fleeing", ("frame_s = 0.1", "frame_s = 0.1\nloss_probability = 0.2"))
    code, found = run("simulate", file)
    assert code == 4 and "share of lost records" in found["reason"]


def test_radius_under_the_floor(written, run, tmp_path):
    """If a guarantee is required there is no plan; otherwise the pursuer drives with a remark."""
    small = ("capture_radius_m = 30.0", "capture_radius_m = 12.0")
    file = written("pursuit_fleeing", small)
    code, found = run("simulate", file, "--out", tmp_path / "none")
    assert code == 4 and found["outcome"] == "no_plan"
    code, checked = run("check", tmp_path / "none")
    assert code == 3 and checked["verdict"] == "none"
    assert checked["reasons"] == [f"there is no plan to verify: {found['message']}"]
    assert (
        "floor below the capture radius: " in found["reason"]
        and "is not below 12 m" in found["reason"]
    )
    with refused(NoPlanError):
        planopt.simulate(planopt.load(file))
    free = planopt.load(written("pursuit_fleeing", small, ('guarantee = "snapshots"', "")))
    assert not planopt.simulate(free).data["guarantee"]["theorems"]["snapshots"]["capture"]["holds"]


WALLS = tuple(
    (line + "\n", "")
    for line in (library_folder() / "pursuit_obstacles.toml").read_text().splitlines()
    if any(f'"{name}"' in line for name in ("hall", "wall", "corner"))
)


def test_guarantees_round_obstacles(written, tmp_path, run):
    """Long walls allow none, and the inequality says so; a tower and fine motes allow one."""
    asked = ("clearance_m = 2.0", 'clearance_m = 2.0\nguarantee = "snapshots"')
    code, found = run("simulate", written("pursuit_obstacles", asked))
    assert code == 4 and "a of the error over 1 - y below 1: 1.8" in found["reason"]
    fine = (
        ("levels = 5", "levels = 9"),
        ("mote_spacing_m = 10.0", "mote_spacing_m = 1.0"),
        ("frame_s = 0.1", "frame_s = 0.01"),
        ("bits_per_axis = 5", "bits_per_axis = 7"),
        ("step_s = 0.2", "step_s = 0.1"),
        ("start_m = [250, 120]", "start_m = [270, 300]"),
    )
    file = written("pursuit_obstacles", asked, *WALLS, *fine)
    code, found = run("simulate", file, "--seed", 2, "--out", tmp_path / "out")
    assert code == 0 and found["outcome"] == "captured" and found["verified_rate"] == 1.0
    assert 1.5 < found["guarantee"]["detour"] < 2.5
    each = found["guarantee"]["theorems"]["snapshots"]
    assert each["distances"] in ("paths", "straight") and each["capture"]["holds"]
    assert found["capture_time_s"] <= each["capture_time_s"]
    assert run("check", tmp_path / "out")[0] == 0


def test_who_escapes(written, run):
    """Given up: exit code 4, and how near it came."""
    code, found = run(
        "simulate", written("pursuit_fleeing", ("step_s = 0.2", "step_s = 0.2\nmax_steps = 9"))
    )
    assert code == 4 and found["outcome"] == "step_limit" and found["capture_time_s"] is None
    assert "not caught in 9 steps, nearest" in found["reason"]


def test_compare(written, tmp_path, run):
    """Settings over the same seeds, paired with the first; the runs are those of simulate."""
    file = written("pursuit_fleeing")
    settings = ("--horizons", "1,5", "--planners", "drive,receding", "--seeds", "7:10")
    code, found = run("compare", file, *settings)
    assert code == 0
    rows = [row for row in found["rows"] if row["metric"] == "capture_time_s"]
    settings = [("drive", 1), ("receding", 1), ("receding", 5)]
    assert [(row["planner"], row["horizon"]) for row in rows] == settings
    assert rows[0]["paired_ratio"] == 1.0 and rows[0]["p50_step_s"] > 0.0
    times = {
        (each["planner"], each["horizon"], each["seed"]): each["metrics"]["capture_time_s"]
        for each in found["runs"]
    }
    again = planopt.simulate(planopt.load(file), planner="receding", horizon=5, seed=8)
    assert times["receding", 5, 8] == again.data["capture_time_s"]
    logs = [np.log(times["receding", 5, seed] / times["drive", 1, seed]) for seed in (7, 8, 9)]
    assert rows[2]["paired_ratio"] == pytest.approx(np.exp(np.mean(logs)))
    for words in (("--planners", "nlp"), ("--costs-to-go", "geodesic")):
        assert run("compare", file, "--horizons", "1", *words)[0] == 2
    with refused():
        planopt.simulate(planopt.load(file), planner="receding", horizon=0)
