"""The schema of problem files: defaults, ranges, strictness, descriptions."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from pydantic import BaseModel

from planopt.errors import InputError
from planopt.problems.problem import ModelTruth, SampledMeasurements
from planopt.problems.schema import ProblemFile, json_schema
from tests.problems.small import built, tables


def test_left_out_keys_get_the_documented_defaults() -> None:
    """The small tables name only what is required; the rest has the defaults of the schema."""
    problem = built(tables())
    assert problem.planner.horizon == 10
    assert problem.planner.name == "auto"
    assert problem.objective.cost_to_go == "connected"
    assert problem.stations[0].site.height_m == 0
    assert problem.channel.measurements == SampledMeasurements(50)
    assert problem.channel.fit_method == "capped"
    assert problem.report.figures


def test_values_land_in_the_right_fields() -> None:
    """Each value of the truth arrives under its own name, whole numbers as floats."""
    data = tables()
    data["channel"]["truth"] |= {"k_pl_db": -31, "floor_db": -120}
    assert built(data).channel.truth == ModelTruth(-31.0, 2.4, 4.0, 15.0, 1.5, 1.0, -120.0)


BAD_VALUES: list[tuple[str, Any, str]] = [
    ("robots.0.speed_max_m_s", -1.0, "is -1.0, should be more than 0 and at most 1000"),
    ("robots.0.start_m", [1.0], "is [1.0], should have more numbers"),
    ("robots.0.start_m", [1.0, 2.0, 3.0], "should have at most 2 items"),
    ("robots.0.goal_m", 3, "is 3, should be an array"),
    ("robots.0.name", "a b", "should match pattern"),
    ("planner.horizon", 0, "is 0, should be at least 1 and at most 500"),
    ("planner.horizon", 10_000, "is 10000, should be at least 1 and at most 500"),
    ("planner.horizon", 2.5, "is 2.5, should be a whole number"),
    ("planner.horizon", True, "is true, should be a whole number"),
    ("planner.name", "magic", "is 'magic', should be 'auto' or 'lattice'"),
    ("planner.step_s", 16**5000, "is a huge number, should be a number"),
    ("constraints.p_min", 1.5, "is 1.5, should be more than 0 and less than 1"),
    ("constraints.p_min", math.nan, "is nan, should be a finite number"),
    ("constraints.clearance_m", math.inf, "is inf, should be a finite number"),
    ("constraints.goal_radius_m", "1", "is '1', should be a number"),
    ("report", {"figures": 1}, "is 1, should be true or false"),
    ("planner", [], "is [], should be a table"),
    ("robots", {}, "is a table, should be an array"),
    ("robots", [], "should have at least 1 item"),
    ("stations", tables()["stations"] * 2, "should have at most 1 item"),
    ("channel.truth.kind", "map", "is 'map', should be one of 'raster', 'model'"),
    ("channel.fit.method", "best", "'seed', 'capped', 'convex', 'nls' or 'reml'"),
    ("problem.schema", 2, "is 2, should be 1"),
]


@pytest.mark.parametrize(("path", "value", "message"), BAD_VALUES)
def test_bad_value_is_one_error_with_key_value_and_what_is_allowed(
    path: str, value: object, message: str
) -> None:
    """The error names the file, the key as the user writes it, the value and what is allowed."""
    data = tables()
    *parents, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    table: Any = data
    for part in parents:
        table = table[part]
    table[last] = value
    with pytest.raises(InputError) as caught:
        built(data)
    key = path.replace(".0.", "[0].")
    assert caught.value.file == "small.toml"
    assert caught.value.key == ("report.figures" if key == "report" else key)
    assert message in caught.value.message


def test_number_too_many_in_a_list_is_located_by_its_place() -> None:
    """Inside arrays of numbers, the key counts down to the number."""
    data = tables()
    data["world"]["obstacles"][0]["polygon"][2][1] = "20"
    with pytest.raises(InputError) as caught:
        built(data)
    assert caught.value.key == "world.obstacles[0].polygon[2][1]"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({}, "exactly one of file, polygon and wkt, has none"),
        ({"wkt": "POINT (0 0)", "file": "a.wkt"}, "has file and wkt"),
        ({"wkt": "POINT (0 0)", "holes": [[[0, 0], [1, 0], [1, 1]]]}, "only with polygon"),
        ({"file": "a.wkt", "name": "a"}, "only with polygon and wkt"),
    ],
)
def test_obstacle_needs_exactly_one_source(table: dict[str, Any], message: str) -> None:
    """An obstacle with no source, with two, or with keys of another source is an error."""
    data = tables()
    data["world"]["obstacles"][1] = table
    with pytest.raises(InputError, match=message) as caught:
        built(data)
    assert caught.value.key == "world.obstacles[1]"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({}, "exactly one of count and file, has none"),
        ({"count": 5, "file": "a.csv"}, "has count and file"),
        ({"count": 5, "columns": {"x": "east"}}, "has columns, which goes only with file"),
    ],
)
def test_measurements_need_exactly_one_source(table: dict[str, Any], message: str) -> None:
    """Measurements are counted or read, never both, and log keys go only with a log."""
    data = tables()
    data["channel"]["measurements"] = table
    with pytest.raises(InputError, match=message) as caught:
        built(data)
    assert caught.value.key == "channel.measurements"


def test_truth_without_kind_misses_its_kind() -> None:
    """The key that chooses between the two truths is named, not the tables of the code."""
    data = tables()
    del data["channel"]["truth"]["kind"]
    with pytest.raises(InputError, match="is missing") as caught:
        built(data)
    assert caught.value.key == "channel.truth.kind"


def test_key_inside_a_truth_is_written_without_its_kind() -> None:
    """``channel.truth.n_pl``, although the validator tells alternatives apart by their kind."""
    data = tables()
    data["channel"]["truth"]["n_pl"] = -2
    with pytest.raises(InputError, match="is -2, should be more than 0") as caught:
        built(data)
    assert caught.value.key == "channel.truth.n_pl"


@pytest.mark.parametrize(
    ("path", "near"),
    [
        (("robots", 0, "sped_max_m_s"), "did you mean speed_max_m_s?"),
        (("constraint",), "did you mean constraints?"),
        (("channel", "truth", "shadow_std"), "did you mean shadow_std_db?"),
        (("problem", "schema_version"), "known: description, name, schema, task"),
        (("targets",), "known: channel, constraints"),
    ],
)
def test_unknown_key_names_the_nearest_known_one(path: tuple[str | int, ...], near: str) -> None:
    """A slip in a key is reported as such, even if the right key is then missing as well."""
    data = tables()
    table: Any = data
    for part in path[:-1]:
        table = table[part]
    table.pop("speed_max_m_s", None)
    table[path[-1]] = {}
    with pytest.raises(InputError, match="is not a known key") as caught:
        built(data)
    assert caught.value.key is not None
    assert caught.value.key.endswith(str(path[-1]))
    assert caught.value.remedy is not None
    if near == "known: description, name, schema, task":
        assert "schema" in caught.value.remedy
    else:
        assert near in caught.value.remedy


def test_missing_key_says_what_it_means() -> None:
    """The description of the schema is the remedy."""
    data = tables()
    del data["robots"][0]["speed_max_m_s"]
    with pytest.raises(InputError) as caught:
        built(data)
    assert caught.value.key == "robots[0].speed_max_m_s"
    assert caught.value.message == "is missing"
    assert caught.value.remedy == "Largest speed in m/s."


def test_data_that_is_no_table_has_no_key() -> None:
    """A list instead of tables is an error of the whole file."""
    with pytest.raises(InputError, match="should be a table") as caught:
        built([1, 2])
    assert caught.value.key is None


def test_every_key_is_described() -> None:
    """The JSON schema describes every key of every table and forbids others."""
    schema = json_schema()
    assert json.loads(json.dumps(schema)) == schema
    definitions = schema["$defs"]
    assert len(definitions) >= 13
    for name, definition in definitions.items():
        assert definition["additionalProperties"] is False, name
        for key, value in definition["properties"].items():
            assert "$ref" in value or value.get("description"), f"{name}.{key}"
    assert schema["properties"]["robots"]["maxItems"] == 1
    assert definitions["PlannerTable"]["properties"]["horizon"]["maximum"] == 500
    assert "schema" in definitions["ProblemTable"]["required"]


def test_unitless_names_are_known() -> None:
    """Every number says its unit in its name, but for those that have none."""
    unitless = {"schema", "n_pl", "rician_k", "count", "p_min", "horizon", "neighbours", "max_steps"}
    units = ("_m", "_s", "_db", "_dbm", "_m_s", "_s2_m2")
    for definition in json_schema()["$defs"].values():
        for key, value in definition["properties"].items():
            if "number" in str(value.get("type", value)) or value.get("type") == "integer":
                assert key in unitless or key.endswith(units) or "polygon" in key or key == "holes"
    assert issubclass(ProblemFile, BaseModel)
