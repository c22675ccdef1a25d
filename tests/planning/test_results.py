"""What solutions and runs offer people: pictures, files, tables, and back from files."""

import csv
import importlib
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from team_scene import two_trackers

import planopt
from planopt import Run, Solution
from planopt.files.tables import table_text
from planopt.planning.files.result_json import no_plan_json
from planopt.planning.files.run_tables import tables_of
from planopt.tasks.motion import NoPlan


@pytest.fixture(scope="module")
def results() -> dict[str, Solution | Run]:
    """Plans and short runs of one robot to a goal and of two that track."""
    reach, team = planopt.load("open_field"), two_trackers()
    short = replace(reach, planner=replace(reach.planner, max_steps=3))
    return {
        "plan": planopt.solve(reach, horizon=3, seed=1),
        "plans": planopt.solve(team, seed=1),
        "run": planopt.simulate(short, horizon=3, seed=1),
        "team": planopt.simulate(team, seed=1),
    }


def table_of(result: Solution | Run) -> str:
    """The text of ``steps.csv`` from the result's own arrays."""
    return table_text(*tables_of(result)["steps.csv"])


@pytest.mark.parametrize("name", ["plan", "plans", "run", "team"])
def test_what_is_saved_comes_back(
    results: dict[str, Solution | Run], name: str, tmp_path: Path
) -> None:
    """The same table, metrics, certificates and belief, of the same type; and check agrees."""
    result = results[name]
    result.save(tmp_path / name)
    assert planopt.check(tmp_path / name).verdict is planopt.Verdict.VERIFIED
    back = planopt.load_result(str(tmp_path / name))
    assert type(back) is type(result) and repr(back) == repr(result)
    assert table_of(back) == table_of(result)
    if isinstance(result, Solution):
        assert [p.certificate for p in back.plans] == [p.certificate for p in result.plans]
        assert [p.objective for p in back.plans] == pytest.approx(
            [p.objective for p in result.plans]
        )
        beliefs, same = [back.belief], [result.belief]
    else:
        assert back.metrics == pytest.approx(result.metrics, nan_ok=True)
        assert [len(made) for made in back.plans] == [len(made) for made in result.plans]
        assert back.first_measurements == result.first_measurements
        beliefs, same = back.beliefs, result.beliefs
    places = np.array([[1.0, 2.0], [30.0, 20.0]])
    for one, other in zip(beliefs, same, strict=True):
        np.testing.assert_allclose(
            one.posterior.predict(places).mean_db, other.posterior.predict(places).mean_db
        )


@pytest.mark.parametrize("name", ["plan", "plans", "run", "team"])
def test_a_frame_has_the_rows_of_the_file(results: dict[str, Solution | Run], name: str) -> None:
    """Every column of ``steps.csv`` with every number, empty cells missing."""
    pytest.importorskip("pandas")
    frame = results[name].to_dataframe()
    rows = list(csv.DictReader(io.StringIO(table_of(results[name]))))
    assert list(frame.columns) == list(rows[0]) and len(frame) == len(rows)
    for column in ("t_s", "x_m", "connectivity", "true_db"):
        said = [float(row[column] or "nan") for row in rows]
        np.testing.assert_array_equal(frame[column].to_numpy(), said)
    assert frame["robot"].tolist() == [row["robot"] for row in rows]
    known = [{"1": True, "0": False}.get(row["connected"]) for row in rows]
    assert [None if cell is None else bool(cell) for cell in known] == [
        None if missing else bool(cell)
        for cell, missing in zip(frame["connected"], frame["connected"].isna(), strict=True)
    ]


def test_without_pandas_there_is_an_error_that_names_it(
    results: dict[str, Solution | Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str, *rest: object) -> object:
        if name == "pandas":
            raise ImportError(name)
        return real(name, *rest)

    real = importlib.import_module
    monkeypatch.setattr("planopt.files.tables.import_module", missing)
    with pytest.raises(planopt.InputError, match="pip install pandas"):
        results["plan"].to_dataframe()


def test_what_is_no_result_is_an_error(tmp_path: Path, results: dict[str, Solution | Run]) -> None:
    """No folder, a record of no plan, and plans of another length than asked."""
    with pytest.raises(planopt.InputError):
        planopt.load_result(tmp_path / "nothing")
    problem = results["plan"].problem
    data = no_plan_json(problem, 0, "cut off")
    NoPlan(problem, (), data, "plan.json", dict).save(tmp_path / "none")
    with pytest.raises(planopt.NoPlanError, match="cut off"):
        planopt.load_result(tmp_path / "none")
    for name, words in (("plan", "has 3 steps"), ("run", "has 3 steps")):
        results[name].save(tmp_path / name)
        file = next((tmp_path / name).glob("*.json"))
        text = (
            file.read_text()
            .replace('"horizon": 3', '"horizon": 4')
            .replace('"horizon":3', '"horizon":4')
        )
        file.write_text(text)
        with pytest.raises(planopt.InputError, match=words):
            planopt.load_result(tmp_path / name)
