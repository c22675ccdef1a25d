"""The problem library and what its files promise."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refused
from scipy.ndimage import binary_dilation, label
from scipy.stats import norm

from planopt import Problem, load
from planopt.channel import Rician
from planopt.cli import main
from planopt.problems import ModelTruth, RasterTruth, library, list_problems
from planopt.problems.library import find_problem
from planopt.problems.load import with_overrides
from planopt.problems.plausibility import problem_warnings
from planopt.world import clearance_m, index_obstacles

NAMES = [entry.name for entry in list_problems()]
LACKING = [entry.name for entry in list_problems() if entry.lacks_data]


def test_library_lists_its_problems_by_name() -> None:
    """Every problem is there, described, plausible, and as it should be for an override."""
    assert len(NAMES) >= 79 and sorted(NAMES) == NAMES
    for entry in list_problems():
        assert entry.description.endswith(".")
        if entry.name in LACKING:
            continue
        problem = load(entry.name)
        assert (problem.name, problem.description) == (entry.name, entry.description)
        assert problem.file == entry.path
        if isinstance(problem, Problem):
            assert not list(problem_warnings(problem))
            assert with_overrides(problem) == problem


def test_library_is_classified() -> None:
    """Every problem has family, difficulty and provenance; every family has three problems."""
    tests = library.classifications()
    assert sorted(tests) == NAMES
    assert {each.difficulty for each in tests.values()} == {"easy", "medium", "hard"}
    assert all(each.provenance for each in tests.values())
    counts = Counter(each.family for each in tests.values())
    assert len(counts) >= 14 and min(counts.values()) >= 3


def test_damaged_classification(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "library_folder", lambda: tmp_path)
    assert library.classifications() == {}
    for text in ("[", "3", "[3]", '[{"family": ""}]', '[{"problem": "one", "age": 3}]'):
        (tmp_path / "families.json").write_text(text)
        with refused():
            library.classifications()


MUNICH = [name for name in NAMES if name.startswith("munich")]


@pytest.mark.parametrize("name", MUNICH)
def test_munich_files_agree_with_their_map(name: str) -> None:
    """The map covers the bounds, its mast is the station, and both ends are truly connected.

    All but the goal that is to be out of contact, which is so clearly.
    """
    problem = load(name)
    truth = problem.channel.truth
    assert isinstance(truth, RasterTruth)
    assert (truth.floor_db, truth.multipath) == (-130, Rician(10.0))
    with np.load(truth.file, allow_pickle=False) as data:
        x, y, gain = data["x"], data["y"], data[truth.variable]
        mast, receiver_height = data["tx"], float(data["rx_z"])
    half = (x[1] - x[0]) / 2
    assert problem.workspace.bounds_m == (x[0] - half, y[0] - half, x[-1] + half, y[-1] + half)
    station = problem.stations[0]
    assert station.site.position_m == pytest.approx(mast[:2])
    assert station.site.height_m == pytest.approx(mast[2] - receiver_height)
    for place in (problem.robots[0].start_m, problem.robots[0].goal_m):
        # A place on the border of cells touches several, and weak ones are noisy.
        cells = gain[np.ix_(np.abs(y - place[1]) <= half, np.abs(x - place[0]) <= half)]
        power = station.transmit_power_dbm + np.nan_to_num(cells, nan=truth.floor_db).max()
        if name == "munich_shadow_goal" and place == problem.robots[0].goal_m:
            assert power < station.threshold_dbm - 10
        else:
            assert power > station.threshold_dbm


@pytest.mark.parametrize(
    ("name", "is_joined"),
    [
        ("munich_courier", True),
        ("munich_islands", False),
        ("munich_long_hole", False),
        ("munich_street_northwest", True),
        ("munich_street_southwest", False),
        ("munich_street_west", False),
        ("munich_unmeasured", True),
    ],
)
def test_connected_path_is_there_or_not(name: str, *, is_joined: bool) -> None:
    """Whether cells in contact join start and goal, by labelling; corners join where all may."""
    problem = load(name)
    truth, station = problem.channel.truth, problem.stations[0]
    assert isinstance(truth, RasterTruth)
    with np.load(truth.file, allow_pickle=False) as data:
        x, y, gain, building = data["x"], data["y"], data[truth.variable], data["building"]
    # Less free space than there is where a path is to be found, more where none is.
    free = ~(binary_dilation(building) if is_joined else building)
    power = station.transmit_power_dbm + np.nan_to_num(gain, nan=-np.inf)
    labels, _ = label(free & (power >= station.threshold_dbm), structure=np.ones((3, 3)))
    start, goal = (
        labels[np.abs(y - place[1]).argmin(), np.abs(x - place[0]).argmin()]
        for place in (problem.robots[0].start_m, problem.goal_m)
    )
    assert start > 0 and goal >= 0
    assert bool(start == goal) is is_joined


def test_courtyard_has_no_free_path(capsys: pytest.CaptureFixture[str]) -> None:
    """Planning ends with exit code 4 and says that obstacles are the reason."""
    assert main(["solve", "munich_courtyard"]) == 4
    assert "obstacles separate the goal robots[0].goal_m = [177.0, 29.0]" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["connect_rooftop", "connect_street"])
def test_searches_for_connection_start_out_of_contact(name: str) -> None:
    """The station is where the map's transmitter is, and the start is in a hole of its coverage."""
    problem = load(name)
    truth, station = problem.channel.truth, problem.stations[0]
    assert isinstance(truth, RasterTruth)
    with np.load(truth.file, allow_pickle=False) as data:
        x, y, gain = data["x"], data["y"], data[truth.variable]
        transmitter, receiver_height = data["tx"], float(data["rx_z"])
    assert station.site.position_m == pytest.approx(transmitter[:2])
    assert station.site.height_m == pytest.approx(transmitter[2] - receiver_height)
    start = problem.robots[0].start_m
    away = np.hypot(x - start[0], (y - start[1])[:, None])
    connected = station.transmit_power_dbm + np.nan_to_num(gain, nan=-np.inf)
    assert away[connected >= station.threshold_dbm].min() > 10.0


def test_open_field_has_inline_obstacles_and_places_out_of_reach() -> None:
    """A wall that is not convex, one obstacle from WKT, and a far end below the bound."""
    problem = load("open_field")
    wall, shed, pond = (obstacle.polygon for obstacle in problem.workspace.obstacles)
    assert wall.convex_hull.area > 2 * wall.area
    assert shed.area == 18 * 12
    assert pond.convex_hull.equals(pond)
    truth, station = problem.channel.truth, problem.stations[0]
    assert isinstance(truth, ModelTruth)
    deviation = np.hypot(truth.shadow_std_db, truth.multipath_std_db)

    def connectivity(places: NDArray[np.float64]) -> NDArray[np.float64]:
        offset = np.linalg.norm(places - station.site.position_m, axis=1)
        distance = np.hypot(offset, station.site.height_m)
        power = station.transmit_power_dbm + truth.k_pl_db - 10 * truth.n_pl * np.log10(distance)
        return norm.cdf((power - station.threshold_dbm) / deviation)

    x, y = np.meshgrid(np.arange(0.5, 120), np.arange(0.5, 100))
    places = np.column_stack([x.ravel(), y.ravel()])
    free = places[clearance_m(index_obstacles(problem.workspace), places) > 0]
    assert 0.1 < (connectivity(free) < problem.constraints.p_min).mean() < 0.5
    ends = np.array([problem.robots[0].start_m, problem.robots[0].goal_m])
    assert (connectivity(ends) > 0.95).all()


def test_installed_library_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In an installed package the library is next to the code, in the folder ``library``."""
    monkeypatch.setattr(library, "__file__", str(tmp_path / "a" / "b" / "library.py"))
    (tmp_path / "problems").mkdir()
    (tmp_path / "problems" / "one.toml").write_text('[problem]\nschema = 1\nname = "one"\n')
    assert [entry.name for entry in list_problems()] == ["one"]
    installed = tmp_path / "a" / "b" / "library"
    installed.mkdir(parents=True)
    (installed / "two.toml").write_text('[problem]\nschema = 1\nname = "two"\n')
    assert [entry.name for entry in list_problems()] == ["two"]
    assert find_problem("two") == installed / "two.toml"


def test_broken_library_file_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Listing tells which file has no readable head, with the key as in the file."""
    monkeypatch.setattr(library, "__file__", str(tmp_path / "library.py"))
    (tmp_path / "library").mkdir()
    path = tmp_path / "library" / "one.toml"
    for text in ("problem = 3\n", "[problem]\ndescription = 3\n", "[world]\n"):
        path.write_text(text)
        with refused() as caught:
            list_problems()
        assert (caught.value.file, caught.value.key) == (str(path), "problem.description")


def test_path_beats_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file called like a library problem is taken; a folder of that name is ignored."""
    monkeypatch.chdir(tmp_path)
    Path("munich_hard").mkdir()
    assert find_problem("munich_hard").is_absolute()
    Path("munich_courier").touch()
    assert find_problem("munich_courier") == Path("munich_courier")
