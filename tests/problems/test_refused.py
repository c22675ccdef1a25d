"""Tables that are no valid problem: each is one error."""

import math

import pytest
from refusals import refused
from small_tables import (
    CART,
    CASADI,
    DATA,
    DROP,
    HEAVY,
    LATE,
    LEARN,
    MAP,
    MAPPING,
    MODEL,
    OWN,
    RASTER,
    REACH,
    RULE,
    TIMED,
    TRACK,
    TWO,
    WHEELS,
    YARD,
    Build,
    Tables,
    of_terms,
    set_keys,
)

from planopt.problems.checks import MAX_TRUTH_CELLS

REFUSED: list[tuple[Tables, Tables]] = [
    # Types and ranges
    (REACH, {"robots.0.speed_max_m_s": -1.0}),
    (REACH, {"robots.0.start_m": [1.0]}),
    (REACH, {"robots.0.start_m": [1.0, 2.0, 3.0]}),
    (REACH, {"robots.0.goal_m": 3}),
    (REACH, {"robots.0.name": "a b"}),
    (REACH, {"planner.horizon": 0}),
    (REACH, {"planner.horizon": 2.5}),
    (REACH, {"planner.horizon": True}),
    (REACH, {"planner.name": "magic"}),
    (REACH, {"planner.step_s": 16**5000}),
    (REACH, {"constraints.p_min": math.nan}),
    (REACH, {"constraints.clearance_m": math.inf}),
    (REACH, {"constraints.goal_radius_m": "1"}),
    (REACH, {"report": {"figures": 1}}),
    (REACH, {"planner": []}),
    (REACH, {"robots": {}}),
    (REACH, {"robots": []}),
    (REACH, {"channel.truth.kind": "map"}),
    (REACH, {"channel.truth.kind": DROP}),
    (REACH, {"channel.truth.n_pl": -2}),
    (REACH, {"channel.fit.method": "best"}),
    (REACH, {"problem.schema": 2}),
    (REACH, {"world.obstacles.0.polygon.2.1": "20"}),
    # Unknown keys name the nearest known one; missing ones say what they mean
    (REACH, {"robots.0.sped_max_m_s": 1, "robots.0.speed_max_m_s": DROP}),
    (REACH, {"constraint": {}}),
    (REACH, {"channel.truth.shadow_std": 1}),
    (REACH, {"problem.version": 1}),
    (REACH, {"robots.0.speed_max_m_s": DROP}),
    # Sources of obstacles, measurements and fading
    (REACH, {"world.obstacles.1": {}}),
    (REACH, {"world.obstacles.1.file": "a.wkt"}),
    (REACH, {"world.obstacles.1.holes": [[[0, 0], [1, 0], [1, 1]]]}),
    (REACH, {"world.obstacles.1": {"file": "a.wkt", "name": "a"}}),
    (REACH, {"channel.measurements": {}}),
    (REACH, {"channel.measurements.file": "a"}),
    (REACH, {"channel.measurements.columns": {}}),
    (REACH, {"channel.truth": DROP}),
    *(
        (REACH, {"channel.truth": truth})
        for truth in (
            RASTER | {"multipath": {"kind": "rician"}},
            RASTER | {"multipath": {"kind": "rician", "m": 3.0, "k": 5.0}},
            RASTER | {"multipath": {"kind": "rayleigh", "k": 5.0}},
            RASTER | {"multipath": {"kind": "rician", "std_db": 7.0}},
            RASTER | {"multipath": {"kind": "nakagami", "m": 1e8}},
            RASTER | {"multipath": {"kind": "rice", "k": 5.0}},
            RASTER | {"multipath": {"kind": "rayleigh"}, "rician_k": 5.0},
            MODEL,
            MODEL | {"multipath": {"kind": "rayleigh"}, "multipath_std_db": 2.0},
        )
    ),
    # Places, bounds, sizes
    *(
        (REACH, {key: place})
        for key in ("robots.0.start_m", "robots.0.goal_m")
        for place in ([25, 15], [20, 15], [19.5, 15], [7, 29.1], [-1, 5], [5, 40.001])
    ),
    *(
        (REACH, {"world.bounds_m": bounds})
        for bounds in ([50, 0, 0, 40], [0, 40, 50, 0], [0, 0, 0, 40])
    ),
    (REACH, {"channel.truth.cell_m": (50 * 40 / MAX_TRUTH_CELLS) ** 0.5 * 0.99}),
    (REACH, {"channel.truth.cell_m": 5e-324}),
    (REACH, YARD | {"robots.0.start_m": [22.5, 15]}),
    (REACH, {"channel.truth.floor_db": -75.0}),
    # Moving obstacles
    *(
        (REACH, {"world.moving": [cart]})
        for cart in (
            CART | {"start_m": [5.0, 6.9]},
            TIMED | {"start_m": [5.0, 8.0]},
            CART | {"times_s": [0.0], "positions_m": [[1.0, 1.0]]},
            CART | {"radius_m": 0.0},
            CART | {"probability": 1.0},
            CART | {"probability": 0.9},
            CART | {"speed": 1.0},
            TIMED | {"times_s": [0, 2], "positions_m": [[1, 1]]},
            TIMED | {"times_s": [2, 2], "positions_m": [[1, 1], [2, 2]]},
        )
    ),
    (REACH, {"world.moving": [CART, CART]}),
    # What a task needs, and what is for others
    (REACH, {"robots.0.goal_m": DROP}),
    (REACH, {"constraints.p_min": 0.0}),
    (REACH, {"planner.name": "random"}),
    (REACH, {"objective": {"terms": [{"kind": "mapping"}]}}),
    (REACH, {"constraints.slack_max_db": 1.0, "constraints.slack_price": 1.0}),
    (TRACK, {"targets": []}),
    (TRACK, {"robots.0.goal_m": [1.0, 1.0]}),
    (TRACK, {"problem.task": "map"}),
    (TRACK, {"objective.cost_to_go": "geodesic"}),
    (MAP, {"constraints.goal_radius_m": 2.0}),
    (MAP, {"objective.terms": [{"kind": "mapping", "form": "two_layer"}] * 2}),
    *(
        (of_terms("map", {**form, key: 0.0}), {})
        for form in (MAPPING, MAPPING | {"form": "information"}, MAPPING | {"form": "average"})
        for key in ("variance_threshold_db2", "closeness_per_m")
    ),
    (of_terms("custom", {"kind": "mapping"}), CASADI),
    (of_terms("connect", OWN), {}),
    (of_terms("custom", OWN | {"steps": 4}), CASADI),
    (of_terms("custom", OWN | {"program": "open 0"}), CASADI),
    (of_terms("custom", OWN | {"program": "target_m[0, 0]"}), CASADI),
    (of_terms("custom", {"kind": "casdi"}), CASADI),
    (of_terms("connect", {"kind": "until_connected", "beyond_m": -1.0}), {}),
    # Several robots and stations
    (LEARN, {"robots.1": TWO}),
    (LEARN, {"robots.1": TWO | {"name": "b"}, "constraints.separation_m": 3.1}),
    (
        REACH,
        {
            "robots.1": TWO | {"name": "b", "start_m": [30.0, 25.0], "goal_m": [45.0, 15.0]},
            "constraints.separation_m": 2.0,
        },
    ),
    # Dynamics
    (LEARN, {"robots.0.dynamics": "double_integrator"}),
    (LEARN, {"robots.0.dynamics": "unicycle"}),
    (LEARN, {"robots.0.dynamics": "bicycle"}),
    *(
        (LEARN, base | {f"robots.0.{key}": value})
        for base, key, value in (
            ({}, "acceleration_max_m_s2", 1.0),
            ({}, "start_velocity_m_s", [0, 0]),
            ({}, "start_heading_rad", 1.0),
            (HEAVY, "turn_rate_max_rad_s", 1.0),
            (WHEELS, "acceleration_max_m_s2", 1.0),
            (HEAVY, "start_velocity_m_s", [1.0, 0.1]),
            (HEAVY, "acceleration_max_m_s2", 0.0),
            (WHEELS, "speed_min_m_s", 0.1),
            (WHEELS, "turn_rate_max_rad_s", 6.3),
        )
    ),
    *(
        (LEARN, HEAVY | {"robots.0.start_m": start, "robots.0.start_velocity_m_s": velocity})
        for start, velocity in (([18.0, 15.0], [0.9, 0.0]), ([0.5, 5.0], [-0.9, 0.0]))
    ),
    *((LEARN, WHEELS | {"planner.name": name}) for name in ("one_step", "random", "lawnmower")),
    # Rules of connectivity
    *(
        (LEARN, {"constraints": rule})
        for rule in (
            RULE | {"connectivity": "average", "outage_max_m": 3.0},
            RULE | {"deadline_s": 3.0},
            {"connectivity": "joint"},
            {"connected_times_s": [2]},
            RULE | {"connectivity": "outage"},
            RULE | {"connectivity": "outage", "outage_max_m": 3.0, "outage_max_s": 3.0},
            {"connectivity": "data", "data_mbit": 3.0, "deadline_s": 3.0},
            {"slack_max_db": 1.0},
            RULE | {"connectivity": "average", "slack_price": 1.0},
            RULE | {"connectivity": "joint", "parameter_uncertainty": "all"},
            {"parameter_uncertainty": "all"},
            RULE | {"connectivity": "sometimes"},
            RULE | {"connectivity": "stated_times", "connected_times_s": [0.5]},
            RULE | {"connectivity": "stated_times", "connected_times_s": [-1.0]},
            DATA | {"data_mbit": math.inf},
            DATA | {"p_min": 0.9999},
            DATA | {"data_mbit": 19.1},
        )
    ),
    (LEARN | LATE, {"constraints": RULE | {"connected_times_s": [5.0, 3.5]}}),
]


@pytest.mark.parametrize(("base", "changes"), REFUSED)
def test_refused(tables: Tables, built: Build, base: Tables, changes: Tables) -> None:
    """The error names the file and a remedy."""
    set_keys(tables, base)
    set_keys(tables, changes)
    with refused() as caught:
        built(tables)
    error = caught.value
    assert error.file == "small.toml"
    assert error.remedy or "should" in error.message or "is missing" in error.message


@pytest.mark.parametrize("base", [REACH, LEARN, MAP, TRACK, LEARN | HEAVY, LEARN | WHEELS])
def test_the_bases_are_no_errors(tables: Tables, built: Build, base: Tables) -> None:
    """What is refused above is refused for its changes."""
    set_keys(tables, base)
    built(tables)


@pytest.mark.parametrize(
    ("base", "changes"),
    [
        *((REACH, {"robots.0.start_m": place}) for place in ([19, 15], [0, 0], [50, 40])),
        (REACH, {"world.obstacles": DROP}),
        (REACH, YARD | {"robots.0.start_m": [25, 15]}),
        (REACH, {"channel.truth.floor_db": -75.1}),
        (REACH, {"channel.truth": DROP, "channel.measurements": {"file": "log.csv"}}),
        (REACH, {"constraints.slack_max_db": 1.0}),
        (LEARN, {"robots.1": TWO | {"name": "b"}, "constraints.separation_m": 3.0}),
        (LEARN, WHEELS | {"robots.0.turn_rate_max_rad_s": 3.14, "planner.step_s": 2.0}),
        (LEARN, HEAVY | {"robots.0.start_velocity_m_s": [0.9, 0.0]}),
        (REACH, HEAVY),
        (LEARN, {"constraints": DATA | {"p_min": 0.9995, "data_mbit": 19.0}}),
        (LEARN | LATE, {"constraints": RULE | {"connected_times_s": [5.0, 3.0]}}),
        (REACH, {"world.moving": [CART | {"probability": 0.9, "position_std_m": 0.1}]}),
    ],
)
def test_what_is_just_allowed(tables: Tables, built: Build, base: Tables, changes: Tables) -> None:
    set_keys(tables, base)
    set_keys(tables, changes)
    built(tables)
