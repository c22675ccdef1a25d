"""The schema of problem files: defaults, ranges, strictness, descriptions."""

import json

import pytest
from refusals import refused
from small_tables import (
    DROP,
    HEAVY,
    LEARN,
    OWN,
    TRACK,
    TRACKING,
    WHEELS,
    Build,
    Tables,
    of_terms,
    set_keys,
)

from planopt.objectives import (
    CasadiTerm,
    LearningTerm,
    MotionEnergyTerm,
    TrackingTerm,
    UntilConnectedTerm,
)
from planopt.problems import (
    DoubleIntegrator,
    ModelTruth,
    SampledMeasurements,
    SingleIntegrator,
    Unicycle,
)
from planopt.problems.schema import json_schema


def test_values_land_in_the_right_fields(tables: Tables, built: Build) -> None:
    """Each under its own name; left-out keys have the documented defaults."""
    problem = built(tables)
    assert problem.planner.horizon == 10
    assert problem.planner.name == "auto"
    assert problem.objective.cost_to_go == "connected"
    assert problem.stations[0].site.height_m == 0
    assert problem.channel.measurements == SampledMeasurements(50)
    assert problem.channel.fit_method == "capped"
    assert problem.report.figures
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


ENERGY = {"kind": "motion_energy", "per_metre_j_m": 2.0}


def test_stations_are_up_to_twenty_with_names_of_their_own(tables: Tables, built: Build) -> None:
    """The error says how many, or whose name it is."""
    (station,) = tables["stations"]
    for count in (20, 21):
        tables["stations"] = [station | {"name": f"s{number}"} for number in range(count)]
        if count == 20:
            assert len(built(tables).stations) == 20
    with refused() as caught:
        built(tables)
    assert caught.value.key == "stations"
    tables["stations"] = [station, station]
    with refused() as caught:
        built(tables)
    assert caught.value.key == "stations[1].name"
    assert caught.value.remedy is not None


def test_data_that_is_no_table_has_no_key(built: Build) -> None:
    """A list instead of tables is an error of the whole file."""
    with refused() as caught:
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


@pytest.mark.parametrize(
    ("task", "terms", "found"),
    [
        ("connect", [{"kind": "until_connected"}], (UntilConnectedTerm(),)),
        (
            "connect",
            [{"kind": "until_connected", "weight": 0.5, "beyond_m": 80.0}, ENERGY],
            (UntilConnectedTerm(80.0, weight=0.5), MotionEnergyTerm(2.0)),
        ),
        ("custom", [OWN | {"weight": -2.0}], (CasadiTerm(5, OWN["program"], weight=-2.0),)),
        (
            "learn",
            [{"kind": "path_loss_learning", "weight": 0.5, "criterion": "A"}],
            (LearningTerm("A", weight=0.5),),
        ),
        ("track", [TRACKING], (TrackingTerm(0.008, 0.08, 1.0),)),
    ],
)
def test_terms_are_read_in_order(
    tables: Tables, built: Build, task: str, terms: list[Tables], found: tuple[object, ...]
) -> None:
    set_keys(tables, (TRACK if task == "track" else {}) | of_terms(task, *terms))
    set_keys(tables, {"planner.horizon": 5})
    problem = built(tables)
    assert (problem.task, problem.objective.terms) == (task, found)
    assert (problem.sense, problem.cost_to_go) == ("max", None)


def test_defaults_of_dynamics(tables: Tables, built: Build) -> None:
    """At rest, heading along x, no driving backward; a single integrator without the keys."""
    set_keys(tables, LEARN)
    assert built(tables).robots[0].dynamics == SingleIntegrator(1.0)
    assert built(tables).robots[0].start_state.tolist() == [5.0, 5.0]
    set_keys(tables, HEAVY)
    assert built(tables).robots[0].dynamics == DoubleIntegrator(1.0, 0.3)
    assert built(tables).robots[0].start_state.tolist() == [5.0, 5.0, 0.0, 0.0]
    set_keys(tables, WHEELS | {"robots.0.acceleration_max_m_s2": DROP})
    assert built(tables).robots[0].dynamics == Unicycle(1.0, 1.0, 0.0)
    assert built(tables).robots[0].start_state.tolist() == [5.0, 5.0, 0.0]
