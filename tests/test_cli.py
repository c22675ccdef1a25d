"""The command line: what each command prints, saves and returns."""

import json
import re
import signal
from pathlib import Path

import pytest

import planopt
from planopt.cli import main
from planopt.commands.options import progress
from planopt.problems.library import library_folder

OPEN_FIELD = (library_folder() / "open_field.toml").read_text()


@pytest.fixture
def field(tmp_path: Path) -> Path:
    """The open field without pictures, and with a short run."""
    path = tmp_path / "field.toml"
    text = OPEN_FIELD.replace("figures = true", "figures = false")
    path.write_text(text.replace("max_steps = 200", "max_steps = 3"))
    return path


@pytest.fixture
def near(tmp_path: Path) -> Path:
    path = tmp_path / "near.toml"
    text = OPEN_FIELD.replace("figures = true", "figures = false")
    path.write_text(text.replace("goal_m = [88.0, 30.0]", "goal_m = [32.0, 36.0]"))
    return path


@pytest.fixture
def cut_off(tmp_path: Path) -> Path:
    """The same with a goal behind a wall from side to side."""
    path = tmp_path / "cut_off.toml"
    wall = '[[world.obstacles]]\nname = "bar"\npolygon = [[70, 0], [72, 0], [72, 100], [70, 100]]\n'
    path.write_text(OPEN_FIELD.replace("[channel.truth]", f"{wall}\n[channel.truth]"))
    return path


def strict(text: str) -> dict:
    """The only JSON object in `text`, without NaN or infinity."""

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    assert text.count("\n") == 1
    return json.loads(text, parse_constant=refuse)


def test_solve_prints_json_or_text(field: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A verified plan: exit code 0, one object on stdout, or the verdict first, in words."""
    assert main(["solve", str(field), "--horizon", "3", "--json"]) == 0
    printed = capsys.readouterr()
    data = strict(printed.out)
    assert printed.err == ""
    assert data["verdict"] == "verified" and data["horizon"] == 3
    assert main(["solve", str(field), "--planner", "lattice", "--cost-to-go", "geodesic"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("open_field: verified, horizon 10 steps, planner lattice")


def test_solve_returns_3_if_not_verified(tmp_path: Path, field: Path, capsys) -> None:
    """A threshold that cannot be met is said, not hidden."""
    hard = tmp_path / "hard.toml"
    hard.write_text(field.read_text().replace("threshold_dbm = -59.0", "threshold_dbm = 0.0"))
    assert main(["solve", str(hard), "--horizon", "2"]) == 3
    assert "is met nowhere in the workspace" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["solve", "simulate"])
def test_no_plan_is_exit_code_4(command: str, cut_off: Path, tmp_path: Path, capsys) -> None:
    """A goal that is cut off: every key is there, the reason in `message`, and it is saved."""
    out = tmp_path / "out"
    assert main([command, str(cut_off), "--json", "--out", str(out)]) == 4
    data = strict(capsys.readouterr().out)
    assert data.get("verdict", "none") == "none" and data.get("outcome", "no_plan") == "no_plan"
    assert "separate" in data["message"] and data["robots"] == []
    assert main(["check", str(out), "--json"]) == 3
    checked = strict(capsys.readouterr().out)
    assert checked["verdict"] == "none" and checked["certificate"]["posterior"] is None
    assert main([command, str(cut_off)]) == 4
    assert "no plan: obstacles separate" in capsys.readouterr().out


def test_a_saved_plan_is_checked(field: Path, tmp_path: Path, capsys) -> None:
    """Check agrees with what was saved, and rejects it after a waypoint was moved."""
    out = tmp_path / "new" / "plan"
    assert main(["solve", str(field), "--out", str(out)]) == 0
    assert {f.name for f in out.iterdir()} == {"plan.json", "steps.csv", "belief.npz"}
    capsys.readouterr()
    assert main(["check", str(out), "--json"]) == 0
    checked = strict(capsys.readouterr().out)
    assert checked["verdict"] == "verified" and checked["reasons"] == []
    assert any("planner.max_steps: 3" in remark for remark in checked["remarks"])
    lines = (out / "steps.csv").read_text().splitlines()
    cells = lines[3].split(",")
    lines[3] = ",".join([*cells[:3], "30.0", "19.0", *cells[5:]])
    (out / "steps.csv").write_text("\n".join(lines))
    assert main(["check", str(out)]) == 3
    assert "steps.csv, row" in capsys.readouterr().out


def test_a_saved_run_is_checked(field: Path, tmp_path: Path, capsys) -> None:
    """A run that ends early is exit code 4, and its released steps are still verified."""
    out = tmp_path / "run"
    assert main(["simulate", str(field), "--seed", "1", "--json", "--out", str(out)]) == 4
    data = strict(capsys.readouterr().out)
    assert data["outcome"] == "step_limit" and data["metrics"]["goal_time_s"] is None
    assert main(["check", str(out / "run.json")]) == 0


def test_a_run_that_arrives_is_exit_code_0(near: Path, capsys) -> None:
    assert main(["simulate", str(near), "--horizon", "3"]) == 0
    assert capsys.readouterr().out.startswith("open_field: reached")


def test_compare_prints_rows(near: Path, tmp_path: Path, capsys) -> None:
    """One row a setting and metric; one run a setting and seed; saved with the problem."""
    arguments = ["compare", str(near), "--horizons", "2,3,2", "--seeds", "2"]
    arguments += ["--costs-to-go", "geodesic", "--planners", "lattice"]
    out = tmp_path / "comparison"
    assert main([*arguments, "--json", "--out", str(out)]) == 0
    data = strict(capsys.readouterr().out)
    settings = {(row["horizon"], row["planner"], row["cost_to_go"]) for row in data["rows"]}
    assert settings == {(2, "lattice", "geodesic"), (3, "lattice", "geodesic")}
    assert set(data["rows"][0]) >= {"seeds", "stalled", "metric", "mean", "ci_low", "ci_high"}
    assert set(data["rows"][0]) >= {"paired_ratio", "verified_rate", "p50_step_s", "p95_step_s"}
    assert [run["seed"] for run in data["runs"]] == [0, 1, 0, 1]
    tables = data["reliability"]
    driven = sum(one["count"] for one in tables["all"])
    assert driven == sum(one["count"] for own in tables["settings"] for one in own["bins"]) > 0
    assert {(own["horizon"], own["cost_to_go"]) for own in tables["settings"]} == {
        (row["horizon"], row["cost_to_go"]) for row in data["rows"]
    }
    assert all(one["ci_low"] is None for one in tables["all"])
    saved = json.loads((out / "comparison.json").read_text())
    assert saved["problem_file"]["problem"]["name"] == "open_field"
    assert main(arguments) == 0
    assert "lattice" in capsys.readouterr().out


def test_compare_returns_4_if_a_run_does_not_arrive(field: Path, capsys) -> None:
    """Three steps are not enough for this goal."""
    arguments = ["compare", str(field), "--horizons", "2", "--seeds", "1", "--json"]
    assert main(arguments) == 4
    assert {row["stalled"] for row in strict(capsys.readouterr().out)["rows"]} == {1}


def test_compare_without_a_plan(cut_off: Path, capsys) -> None:
    """A goal that is cut off is exit code 4 with no rows."""
    assert main(["compare", str(cut_off), "--horizons", "2", "--seeds", "1", "--json"]) == 4
    data = strict(capsys.readouterr().out)
    assert data["rows"] == [] and data["outcome"] == "no_plan"


def test_pictures_are_drawn(near: Path, tmp_path: Path) -> None:
    """Where the problem asks for figures, each command saves its own, as PNG files."""
    near.write_text(near.read_text().replace("figures = false", "figures = true"))
    more = {"solve": [], "simulate": [], "compare": ["--horizons", "3", "--seeds", "1"]}
    wanted = {
        "solve": {"plan.png", "belief.png"},
        "simulate": {"run.png", "series.png", "belief.png"},
        "compare": {"comparison.png", "reliability.png"},
    }
    for command, arguments in more.items():
        out = tmp_path / command
        assert main([command, str(near), *arguments, "--out", str(out)]) == 0
        pictures = {path for path in out.iterdir() if path.suffix == ".png"}
        assert {path.name for path in pictures} == wanted[command]
        assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)


def test_list_and_schema(capsys) -> None:
    """The library's names, and a JSON schema that is JSON."""
    assert main(["list"]) == 0
    assert "munich_courier" in capsys.readouterr().out
    assert main(["list", "--json"]) == 0
    (field,) = (e for e in strict(capsys.readouterr().out)["problems"] if e["name"] == "open_field")
    assert (field["family"], field["difficulty"]) == ("thin walls", "easy")
    assert main(["schema"]) == 0
    readable = json.loads(capsys.readouterr().out)
    assert main(["schema", "--json"]) == 0
    assert strict(capsys.readouterr().out) == readable
    assert "constraints" in readable["properties"]


def test_help_and_version(capsys) -> None:
    """All are exit code 0 on stdout; no summary is cut; without arguments three are shown."""
    main(["--help"])
    assert "...\n" not in capsys.readouterr().out.replace("[ARGS]...\n", "")
    assert main([]) == 0
    shown = re.findall("^  planopt ([a-z]+)", capsys.readouterr().out, re.MULTILINE)
    assert shown == ["list", "solve", "simulate"]
    assert main(["--help"]) == 0
    assert "simulate" in capsys.readouterr().out
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"{planopt.__version__}\n"


@pytest.mark.parametrize("command", ["simulate", "compare"])
def test_help_lists_the_planners_of_every_task(command, capsys) -> None:
    """Those of networks and pursuits are as their schemas have them."""
    assert main([command, "--help"]) == 0
    words = re.findall(r"\w+", capsys.readouterr().out)
    for task in ("coverage", "pursuit"):
        assert main(["schema", "--task", task]) == 0
        tables = json.loads(capsys.readouterr().out)["$defs"]
        names = tables["PlannerTable"]["properties"]["name"]["enum"]
        assert set(names) <= set(words)


def test_interrupts(field: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """Ctrl-C before or in a command: exit code 130, no traceback, and no folder left."""

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("planopt.planning.solve.solve", interrupted)
    assert main(["solve", str(field), "--out", str(tmp_path / "out")]) == 130
    assert "Traceback" not in capsys.readouterr().err
    assert not (tmp_path / "out").exists()

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("planopt.cli.app", interrupted)
    assert main([]) == 130


def test_an_interrupt_that_is_swallowed_still_stops() -> None:
    """CasADi turns a Ctrl-C into the end of one solve; the work after it must not go on."""
    before = signal.getsignal(signal.SIGINT)
    parts = 0
    with pytest.raises(KeyboardInterrupt), progress("working") as advance:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            parts += 1
        advance()
        parts += 1
    assert parts == 1
    assert signal.getsignal(signal.SIGINT) is before


def test_a_fault_of_ours_is_not_hidden(field: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is neither bad input nor usage is a fault, and shows as one."""

    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("planopt.planning.solve.solve", broken)
    with pytest.raises(ZeroDivisionError):
        main(["solve", str(field)])


def test_unverified_plans_have_a_reason(field: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An average that no plan can have: reached or not, the text says why."""
    text = field.read_text().replace("[constraints]", '[constraints]\nconnectivity = "average"')
    field.write_text(re.sub(r"threshold_dbm = .*", "threshold_dbm = -30.0", text))
    assert main(["simulate", str(field), "--horizon", "2"]) != 0
    printed = capsys.readouterr().out
    told = re.search(r"(\d+) of 3 plans are not verified. Reason for the last one: (.+)", printed)
    assert told is not None and told.group(1) == "3"
    assert "constraints.p_min requires" in told.group(2)


def test_goal_that_no_single_change_opens(
    cut_off: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two walls: no single obstacle to be taken away, and no clearance, helps."""
    walls = "".join(
        f'[[world.obstacles]]\nname = "wall {x}"\n'
        f"polygon = [[{x}, 0], [{x + 2}, 0], [{x + 2}, 100], [{x}, 100]]\n\n"
        for x in (74, 78)
    )
    text = cut_off.read_text().replace("figures = true", "figures = false")
    cut_off.write_text(text.replace("[channel.truth]", f"{walls}[channel.truth]"))
    assert main(["solve", str(cut_off)]) == 4
    assert (
        "no tested change of one key, or removal of one obstacle, gives a plan"
        in capsys.readouterr().out
    )
