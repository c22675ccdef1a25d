"""The schema of problem files: defaults, ranges, strictness, descriptions."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import pytest

from planopt.errors import InputError
from planopt.objectives import (
    CasadiTerm,
    LearningTerm,
    MotionEnergyTerm,
    TrackingTerm,
    UntilConnectedTerm,
)
from planopt.problems.channel_setup import ModelTruth, SampledMeasurements
from planopt.problems.problem import Problem
from planopt.problems.save import problem_from_dict, problem_to_dict
from planopt.problems.schema import json_schema


def test_left_out_keys_get_the_documented_defaults(tables: Tables, built: Build) -> None:
    """The small tables name only what is required; the rest has the defaults of the schema."""
    problem = built(tables)
    assert problem.planner.horizon == 10
    assert problem.planner.name == "auto"
    assert problem.objective.cost_to_go == "connected"
    assert problem.stations[0].site.height_m == 0
    assert problem.channel.measurements == SampledMeasurements(50)
    assert problem.channel.fit_method == "capped"
    assert problem.report.figures


def test_values_land_in_the_right_fields(tables: Tables, built: Build) -> None:
    """Each value of the truth arrives under its own name, whole numbers as floats."""
    tables["channel"]["truth"] |= {"k_pl_db": -31, "floor_db": -120}
    assert built(tables).channel.truth == ModelTruth(
        k_pl_db=-31.0,
        n_pl=2.4,
        shadow_std_db=4.0,
        decorrelation_m=15.0,
        multipath_std_db=1.5,
        cell_m=1.0,
        floor_db=-120.0,
    )


Tables = dict[str, Any]
Build = Callable[[object], Problem]

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
    ("planner.name", "magic", "is 'magic', should be 'auto', 'nlp', 'scp', 'lattice'"),
    ("constraints.p_min", 1.5, "is 1.5, should be at least 0 and less than 1"),
    ("constraints.p_min", math.nan, "is nan, should be a finite number"),
    ("constraints.clearance_m", math.inf, "is inf, should be a finite number"),
    ("constraints.goal_radius_m", "1", "is '1', should be a number"),
    ("report", {"figures": 1}, "is 1, should be true or false"),
    ("planner", [], "is [], should be a table"),
    ("robots", {}, "is a table, should be an array"),
    ("robots", [], "should have at least 1 item"),
    ("channel.truth.kind", "map", "is 'map', should be one of 'raster', 'model'"),
    ("channel.fit.method", "best", "'lemma1', 'capped', 'convex', 'nls' or 'reml'"),
    ("problem.schema", 2, "is 2, should be 1"),
    ("problem.schema", None, "is None, should be 1"),
]


@pytest.mark.parametrize(("path", "value", "message"), BAD_VALUES)
def test_bad_value_is_one_error_with_key_value_and_what_is_allowed(
    tables: Tables, built: Build, path: str, value: object, message: str
) -> None:
    """The error names the file, the key as the user writes it, the value and what is allowed."""
    *parents, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    table: Any = tables
    for part in parents:
        table = table[part]
    table[last] = value
    with pytest.raises(InputError) as caught:
        built(tables)
    key = path.replace(".0.", "[0].")
    assert caught.value.file == "small.toml"
    assert caught.value.key == ("report.figures" if key == "report" else key)
    assert message in caught.value.message


def test_number_that_python_cannot_print_is_still_one_error(tables: Tables, built: Build) -> None:
    """A hexadecimal number of 5,000 digits parses as TOML, and Python refuses its decimals."""
    tables["planner"]["step_s"] = 16**5000
    with pytest.raises(InputError, match="is a huge number, should be a number"):
        built(tables)


def test_every_robot_of_the_task_reach_needs_a_goal_of_its_own(
    tables: Tables, built: Build
) -> None:
    """The error names the robot without one, and the goals that are too near to each other."""
    first = tables["robots"][0]
    second = first | {"name": "second", "start_m": [30.0, 25.0]}
    tables["robots"] = [first, {key: second[key] for key in second if key != "goal_m"}]
    with pytest.raises(InputError, match=r"task reach needs robots\[1\]\.goal_m"):
        built(tables)
    tables["robots"] = [first, second]
    assert len(built(tables).robots) == 2
    tables["constraints"]["separation_m"] = 2.0
    with pytest.raises(InputError, match="0 m from the goal of") as caught:
        built(tables)
    assert caught.value.key == "robots[1].goal_m"


def test_stations_are_up_to_twenty_with_names_of_their_own(tables: Tables, built: Build) -> None:
    """The error says how many, or whose name it is."""
    (station,) = tables["stations"]
    for count in (20, 21):
        tables["stations"] = [station | {"name": f"s{number}"} for number in range(count)]
        if count == 20:
            assert len(built(tables).stations) == 20
    with pytest.raises(InputError, match="should have at most 20 items") as caught:
        built(tables)
    assert caught.value.key == "stations"
    tables["stations"] = [station, station]
    with pytest.raises(InputError, match=r"as that of stations\[0\] is") as caught:
        built(tables)
    assert caught.value.key == "stations[1].name"
    assert caught.value.remedy is not None


def test_value_in_an_array_is_located_by_its_place(tables: Tables, built: Build) -> None:
    """Inside arrays of numbers, the key counts down to the number."""
    tables["world"]["obstacles"][0]["polygon"][2][1] = "20"
    with pytest.raises(InputError) as caught:
        built(tables)
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
def test_obstacle_needs_exactly_one_source(
    tables: Tables, built: Build, table: dict[str, Any], message: str
) -> None:
    """An obstacle with no source, with two, or with keys of another source is an error."""
    tables["world"]["obstacles"][1] = table
    with pytest.raises(InputError, match=message) as caught:
        built(tables)
    assert caught.value.key == "world.obstacles[1]"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({}, "exactly one of count and file, has none"),
        ({"count": 5, "file": "a.csv"}, "has count and file"),
        ({"count": 5, "columns": {"x": "east"}}, "has columns, which goes only with file"),
    ],
)
def test_measurements_need_exactly_one_source(
    tables: Tables, built: Build, table: dict[str, Any], message: str
) -> None:
    """Measurements are counted or read, never both, and log keys go only with a log."""
    tables["channel"]["measurements"] = table
    with pytest.raises(InputError, match=message) as caught:
        built(tables)
    assert caught.value.remedy
    assert caught.value.key == "channel.measurements"


def test_truth_without_kind_misses_its_kind(tables: Tables, built: Build) -> None:
    """The key that chooses between the two truths is named, not the tables of the code."""
    del tables["channel"]["truth"]["kind"]
    with pytest.raises(InputError, match="is missing") as caught:
        built(tables)
    assert caught.value.key == "channel.truth.kind"


def test_key_inside_a_truth_is_written_without_its_kind(tables: Tables, built: Build) -> None:
    """``channel.truth.n_pl``, although the validator tells alternatives apart by their kind."""
    tables["channel"]["truth"]["n_pl"] = -2
    with pytest.raises(InputError, match="is -2, should be more than 0") as caught:
        built(tables)
    assert caught.value.key == "channel.truth.n_pl"


@pytest.mark.parametrize(
    ("path", "near"),
    [
        (("robots", 0, "sped_max_m_s"), "did you mean speed_max_m_s?"),
        (("constraint",), "did you mean constraints?"),
        (("channel", "truth", "shadow_std"), "did you mean shadow_std_db?"),
        (("problem", "version"), "known: description, name, schema, task"),
        (("sensors",), "known: channel, compare, constraints"),
    ],
)
def test_unknown_key_names_the_nearest_known_one(
    tables: Tables, built: Build, path: tuple[str | int, ...], near: str
) -> None:
    """A slip in a key is reported as such, even if the right key is then missing as well."""
    table: Any = tables
    for part in path[:-1]:
        table = table[part]
    table.pop("speed_max_m_s", None)
    table[path[-1]] = {}
    with pytest.raises(InputError, match="is not a known key") as caught:
        built(tables)
    assert caught.value.key is not None
    assert caught.value.key.endswith(str(path[-1]))
    assert caught.value.remedy is not None
    assert near in caught.value.remedy


def test_missing_key_says_what_it_means(tables: Tables, built: Build) -> None:
    """The description of the schema is the remedy."""
    del tables["robots"][0]["speed_max_m_s"]
    with pytest.raises(InputError) as caught:
        built(tables)
    assert caught.value.key == "robots[0].speed_max_m_s"
    assert caught.value.message == "is missing"
    assert caught.value.remedy == "Largest speed in m/s."


def test_data_that_is_no_table_has_no_key(built: Build) -> None:
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
    assert schema["properties"]["robots"]["maxItems"] == 20
    assert definitions["PlannerTable"]["properties"]["horizon"]["maximum"] == 500
    assert "schema" in definitions["ProblemTable"]["required"]


RASTER = {"kind": "raster", "file": "a.npz", "floor_db": -130.0}
MODEL = {"kind": "model", "k_pl_db": -30.0, "n_pl": 2.0, "shadow_std_db": 4.0} | {
    "decorrelation_m": 10.0,
    "cell_m": 1.0,
}


@pytest.mark.parametrize(
    ("truth", "says"),
    [
        (RASTER | {"multipath": {"kind": "rician"}}, "is given by nothing"),
        (RASTER | {"multipath": {"kind": "rician", "m": 3.0, "k": 5.0}}, "given by m and k"),
        (RASTER | {"multipath": {"kind": "rayleigh", "k": 5.0}}, "the kind alone"),
        (RASTER | {"multipath": {"kind": "rician", "std_db": 7.0}}, "deviation of 7"),
        (RASTER | {"multipath": {"kind": "rician", "std_db": 0.0}}, "deviation of 0"),
        (RASTER | {"multipath": {"kind": "nakagami", "m": 1e8}}, "less than 0.001 dB"),
        (RASTER | {"multipath": {"kind": "rice", "k": 5.0}}, "channel.truth.multipath.kind"),
        (RASTER | {"multipath": {"kind": "rayleigh"}, "rician_k": 5.0}, "one is enough"),
        (MODEL, "multipath_std_db and multipath, has none"),
        (MODEL | {"multipath": {"kind": "rayleigh"}, "multipath_std_db": 2.0}, "has both"),
    ],
)
def test_multipath_that_is_not_one(tables: Tables, built: Build, truth: Tables, says: str) -> None:
    """Too many numbers, too few, or one for which there is no such fading; the key is named."""
    tables["channel"]["truth"] = truth
    with pytest.raises(InputError) as caught:
        built(tables)
    assert says in str(caught.value) and "channel.truth" in str(caught.value)
    assert caught.value.remedy


def tracking(tables: Tables) -> Tables:
    """The small problem as one that is to track a target."""
    del tables["robots"][0]["goal_m"]
    tables["problem"]["task"] = "track"
    tables["targets"] = [{"start_m": [5.0, 5.0], "velocity_m_s": [0.1, 0.0]}]
    tables["objective"] = {
        "terms": [
            {
                "kind": "tracking",
                "noise_curvature": 0.008,
                "noise_floor_m2": 0.08,
                "sweet_spot_m": 1.0,
            },
            {"kind": "path_loss_learning", "weight": 0.5, "criterion": "A"},
        ]
    }
    return tables


def test_terms_are_read_in_order(tables: Tables, built: Build) -> None:
    """A problem that is to track has its terms, its target, and survives saving."""
    problem = built(tracking(tables))
    assert problem.task == "track"
    assert problem.sense == "max"
    assert problem.cost_to_go is None
    assert problem.objective.terms == (
        TrackingTerm(0.008, 0.08, 1.0),
        LearningTerm("A", weight=0.5),
    )
    assert problem.targets[0].velocity_m_s == (0.1, 0.0)
    again = problem_from_dict(problem_to_dict(problem), file=problem.file)
    assert again.objective == problem.objective
    assert again.targets == problem.targets


OWN = {"kind": "casadi", "weight": -2.0, "steps": 5, "program": "1.5"}
ENERGY = {"kind": "motion_energy", "per_metre_j_m": 2.0}


@pytest.mark.parametrize(
    ("task", "terms", "found"),
    [
        ("connect", [{"kind": "until_connected"}], (UntilConnectedTerm(),)),
        (
            "connect",
            [{"kind": "until_connected", "weight": 0.5, "beyond_m": 80.0}, ENERGY],
            (
                UntilConnectedTerm(80.0, weight=0.5),
                MotionEnergyTerm(2.0),
            ),
        ),
        ("custom", [OWN], (CasadiTerm(5, OWN["program"], weight=-2.0),)),
    ],
)
def test_tasks_of_other_terms_survive_saving(
    tables: Tables, built: Build, task: str, terms: list[Tables], found: tuple[object, ...]
) -> None:
    """Their tasks, keys and defaults."""
    other(tables, task, terms)
    problem = built(tables)
    assert (problem.task, problem.terms) == (task, found)
    text = json.dumps(problem_to_dict(problem))
    again = problem_from_dict(json.loads(text), file=problem.file)
    assert again.objective == problem.objective


def other(tables: Tables, task: str, terms: list[Tables]) -> None:
    """The small problem for other terms, with a horizon of 5."""
    del tables["robots"][0]["goal_m"]
    tables["problem"]["task"] = task
    tables["objective"] = {"terms": terms}
    tables["planner"]["horizon"] = 5


@pytest.mark.parametrize(
    ("task", "term", "words"),
    [
        (
            "custom",
            {"kind": "mapping"},
            "begin with one of kind casadi",
        ),
        ("connect", OWN, "begin with one of kind until_connected"),
        (
            "custom",
            {**OWN, "steps": 4},
            r"objective.terms\[0\].steps: is 4, and planner.horizon is 5",
        ),
        ("custom", {**OWN, "program": "open 0 1"}, r"objective.terms\[0\].program: line 1"),
        (
            "custom",
            {**OWN, "program": "target_m[0, 0]"},
            r"objective.terms\[0\].program: reads target_m, and there is no target",
        ),
        (
            "connect",
            {"kind": "until_connected", "beyond_m": -1.0},
            r"objective.terms\[0\].beyond_m: is -1.0, should be at least 0 and at most",
        ),
        ("custom", {"kind": "casdi"}, r"objective.terms\[0\].kind: is 'casdi', should be one of"),
    ],
)
def test_other_terms_that_cannot_be_used(
    tables: Tables, built: Build, task: str, term: Tables, words: str
) -> None:
    """The key is named."""
    other(tables, task, [term])
    with pytest.raises(InputError, match=words):
        built(tables)


def drop_target(tables: Tables) -> None:
    """No target."""
    tables["targets"] = []


def give_goal(tables: Tables) -> None:
    """A goal."""
    tables["robots"][0]["goal_m"] = [1.0, 1.0]


def mapping_first(tables: Tables) -> None:
    """Another task first."""
    tables["objective"]["terms"].insert(0, {"kind": "mapping"})


def way_beyond(tables: Tables) -> None:
    """A way beyond the horizon."""
    tables["objective"]["cost_to_go"] = "geodesic"


def twice(tables: Tables) -> None:
    """Two robots of one name."""
    tables["robots"] *= 2


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (drop_target, "a term of kind tracking and an entry of targets go together"),
        (give_goal, "task track has no robots.goal_m"),
        (mapping_first, "begin with one of kind tracking"),
        (way_beyond, "objective: has cost_to_go, which is for task reach"),
        (twice, r"robots\[1\].name is .*, as that of robots\[0\]"),
    ],
)
def test_tables_that_do_not_fit_the_task(
    tables: Tables, built: Build, spoil: Callable[[Tables], None], words: str
) -> None:
    """What belongs to another task, or is missing for this one, is named."""
    tracking(tables)
    spoil(tables)
    with pytest.raises(InputError, match=words) as caught:
        built(tables)
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("table", "key", "value", "words"),
    [
        ("constraints", "p_min", 0.0, "task reach needs constraints.p_min above 0"),
        ("planner", "name", "random", "toml: planner.name random is not for task reach"),
        ("objective", "terms", [{"kind": "mapping"}], "task reach has no objective.terms"),
    ],
)
def test_reach_refuses_what_is_for_other_tasks(
    tables: Tables, built: Build, table: str, key: str, value: object, words: str
) -> None:
    """A problem that is to reach a goal keeps a bound and has no terms."""
    tables.setdefault(table, {})[key] = value
    with pytest.raises(InputError, match=words) as caught:
        built(tables)
    assert caught.value.remedy
