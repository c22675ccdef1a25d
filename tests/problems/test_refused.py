"""One table of what problem files may not say: the key that is named, and the words."""

from __future__ import annotations

import math

import pytest
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

from planopt import InputError
from planopt.problems.checks import MAX_TRUTH_CELLS

REFUSED: list[tuple[Tables, Tables, str | None, str]] = [
    # Types and ranges
    (REACH, {"robots.0.speed_max_m_s": -1.0}, "=", "is -1.0, should be more than 0 and at most"),
    (REACH, {"robots.0.start_m": [1.0]}, "=", "is [1.0], should have more numbers"),
    (REACH, {"robots.0.start_m": [1.0, 2.0, 3.0]}, "=", "should have at most 2 items"),
    (REACH, {"robots.0.goal_m": 3}, "=", "is 3, should be an array"),
    (REACH, {"robots.0.name": "a b"}, "=", "should match pattern"),
    (REACH, {"planner.horizon": 0}, "=", "is 0, should be at least 1 and at most 500"),
    (REACH, {"planner.horizon": 2.5}, "=", "is 2.5, should be a whole number"),
    (REACH, {"planner.horizon": True}, "=", "is true, should be a whole number"),
    (REACH, {"planner.name": "magic"}, "=", "is 'magic', should be 'auto', 'nlp', 'scp'"),
    (REACH, {"planner.step_s": 16**5000}, "=", "is a huge number, should be a number"),
    (REACH, {"constraints.p_min": math.nan}, "=", "is nan, should be a finite number"),
    (REACH, {"constraints.clearance_m": math.inf}, "=", "is inf, should be a finite number"),
    (REACH, {"constraints.goal_radius_m": "1"}, "=", "is '1', should be a number"),
    (REACH, {"report": {"figures": 1}}, "report.figures", "is 1, should be true or false"),
    (REACH, {"planner": []}, "=", "is [], should be a table"),
    (REACH, {"robots": {}}, "=", "is a table, should be an array"),
    (REACH, {"robots": []}, "=", "should have at least 1 item"),
    (REACH, {"channel.truth.kind": "map"}, "=", "is 'map', should be one of 'raster', 'model'"),
    (REACH, {"channel.truth.kind": DROP}, "=", "is missing"),
    (REACH, {"channel.truth.n_pl": -2}, "=", "is -2, should be more than 0"),
    (REACH, {"channel.fit.method": "best"}, "=", "'lemma1', 'capped', 'convex', 'nls' or 'reml'"),
    (REACH, {"problem.schema": 2}, "=", "is 2, should be 1"),
    (REACH, {"world.obstacles.0.polygon.2.1": "20"}, "=", "is '20', should be a number"),
    # Unknown keys name the nearest known one; missing ones say what they mean
    (REACH, {"robots.0.sped_max_m_s": 1, "robots.0.speed_max_m_s": DROP}, "=", "speed_max_m_s?"),
    (REACH, {"constraint": {}}, "=", "did you mean constraints?"),
    (REACH, {"channel.truth.shadow_std": 1}, "=", "did you mean shadow_std_db?"),
    (REACH, {"problem.version": 1}, "=", "known: description, name, schema, task"),
    (REACH, {"robots.0.speed_max_m_s": DROP}, "=", "is missing (Largest speed in m/s.)"),
    # Sources of obstacles, measurements and fading
    (REACH, {"world.obstacles.1": {}}, "=", "exactly one of file, polygon and wkt, has none"),
    (REACH, {"world.obstacles.1.file": "a.wkt"}, "world.obstacles[1]", "has file and wkt"),
    (REACH, {"world.obstacles.1.holes": [[[0, 0], [1, 0], [1, 1]]]}, None, "only with polygon"),
    (REACH, {"world.obstacles.1": {"file": "a.wkt", "name": "a"}}, "=", "only with polygon and"),
    (REACH, {"channel.measurements": {}}, "=", "exactly one of count and file, has none"),
    (REACH, {"channel.measurements.file": "a"}, "channel.measurements", "has count and file"),
    (REACH, {"channel.measurements.columns": {}}, "channel.measurements", "only with file"),
    (REACH, {"channel.truth": DROP}, "channel.measurements.count", "truth that is not given"),
    *(
        (REACH, {"channel.truth": truth}, None, words)
        for truth, words in (
            (RASTER | {"multipath": {"kind": "rician"}}, "is given by nothing"),
            (RASTER | {"multipath": {"kind": "rician", "m": 3.0, "k": 5.0}}, "given by m and k"),
            (RASTER | {"multipath": {"kind": "rayleigh", "k": 5.0}}, "the kind alone"),
            (RASTER | {"multipath": {"kind": "rician", "std_db": 7.0}}, "deviation of 7"),
            (RASTER | {"multipath": {"kind": "nakagami", "m": 1e8}}, "less than 0.001 dB"),
            (RASTER | {"multipath": {"kind": "rice", "k": 5.0}}, "channel.truth.multipath.kind"),
            (RASTER | {"multipath": {"kind": "rayleigh"}, "rician_k": 5.0}, "one is enough"),
            (MODEL, "multipath_std_db and multipath, has none"),
            (MODEL | {"multipath": {"kind": "rayleigh"}, "multipath_std_db": 2.0}, "has both"),
        )
    ),
    # Places, bounds, sizes
    *(
        (REACH, {key: place}, "=", words)
        for key in ("robots.0.start_m", "robots.0.goal_m")
        for place, words in (
            ([25, 15], "is [25.0, 15.0], inside the obstacle hall"),
            ([20, 15], "inside the obstacle hall"),
            ([19.5, 15], "0.5 m from the obstacle hall, less than the clearance of 1 m"),
            ([7, 29.1], "0.9 m from the obstacle obstacle 1"),
            ([-1, 5], "outside the bounds [0.0, 0.0, 50.0, 40.0]"),
            ([5, 40.001], "outside the bounds"),
        )
    ),
    *(
        (REACH, {"world.bounds_m": bounds}, "=", "x_min < x_max")
        for bounds in ([50, 0, 0, 40], [0, 40, 50, 0], [0, 0, 0, 40])
    ),
    (
        REACH,
        {"channel.truth.cell_m": (50 * 40 / MAX_TRUTH_CELLS) ** 0.5 * 0.99},
        "=",
        "more than 4e+06",
    ),
    (REACH, {"channel.truth.cell_m": 5e-324}, "=", "cells"),
    (REACH, YARD | {"robots.0.start_m": [22.5, 15]}, None, "0.5 m from the obstacle hall"),
    (REACH, {"channel.truth.floor_db": -75.0}, "stations[0].threshold_dbm", "floor of -55 dBm"),
    # Moving obstacles
    *(
        (REACH, {"world.moving": [cart]}, key, words)
        for cart, key, words in (
            (CART | {"start_m": [5.0, 6.9]}, "robots[0].start_m", "0.9 m from where"),
            (TIMED | {"start_m": [5.0, 8.0]}, "world.moving[0]", "needs either start_m and"),
            (CART | {"times_s": [0.0], "positions_m": [[1.0, 1.0]]}, None, "needs either"),
            (CART | {"radius_m": 0.0}, "world.moving[0].radius_m", "should be more than 0"),
            (CART | {"probability": 1.0}, "world.moving[0].probability", "less than 1"),
            (CART | {"probability": 0.9}, "world.moving[0]", "needs position_std_m or"),
            (CART | {"speed": 1.0}, "world.moving[0].speed", "is not a known key"),
            (TIMED | {"times_s": [0, 2], "positions_m": [[1, 1]]}, None, "2 times_s and 1 pos"),
            (TIMED | {"times_s": [2, 2], "positions_m": [[1, 1], [2, 2]]}, None, "not increase"),
        )
    ),
    (REACH, {"world.moving": [CART, CART]}, None, "moving[1].name is 'cart', as that of"),
    # What a task needs, and what is for others
    (REACH, {"robots.0.goal_m": DROP}, None, "task reach needs robots[0].goal_m"),
    (REACH, {"constraints.p_min": 0.0}, None, "task reach needs constraints.p_min above 0"),
    (REACH, {"planner.name": "random"}, None, "planner.name random is not for task reach"),
    (REACH, {"objective": {"terms": [{"kind": "mapping"}]}}, None, "has no objective.terms"),
    (REACH, {"constraints.slack_max_db": 1.0, "constraints.slack_price": 1.0}, None, "no price"),
    (TRACK, {"targets": []}, None, "term of kind tracking and an entry of targets go together"),
    (TRACK, {"robots.0.goal_m": [1.0, 1.0]}, None, "task track has no robots.goal_m"),
    (TRACK, {"problem.task": "map"}, None, "begin with one of kind mapping"),
    (TRACK, {"objective.cost_to_go": "geodesic"}, "objective", "which is for task reach"),
    (MAP, {"constraints.goal_radius_m": 2.0}, None, "constraints.goal_radius_m is for task reach"),
    (MAP, {"objective.terms": [{"kind": "mapping", "form": "two_layer"}] * 2}, None, "two_layer"),
    *(
        (of_terms("map", {**form, key: 0.0}), {}, "objective.terms[0]", f"has {key}, which goes")
        for form in (MAPPING, MAPPING | {"form": "information"}, MAPPING | {"form": "average"})
        for key in ("variance_threshold_db2", "closeness_per_m")
    ),
    (of_terms("custom", {"kind": "mapping"}), CASADI, None, "begin with one of kind casadi"),
    (of_terms("connect", OWN), {}, None, "begin with one of kind until_connected"),
    (of_terms("custom", OWN | {"steps": 4}), CASADI, "objective.terms[0].steps", "is 4, and"),
    (of_terms("custom", OWN | {"program": "open 0"}), CASADI, None, "line 1"),
    (of_terms("custom", OWN | {"program": "target_m[0, 0]"}), CASADI, None, "there is no target"),
    (of_terms("custom", {"kind": "casdi"}), CASADI, "objective.terms[0].kind", "is 'casdi'"),
    (
        of_terms("connect", {"kind": "until_connected", "beyond_m": -1.0}),
        {},
        "objective.terms[0].beyond_m",
        "is -1.0, should be at least 0 and at most",
    ),
    # Several robots and stations
    (LEARN, {"robots.1": TWO}, None, "robots[1].name is 'robot', as that of"),
    (
        LEARN,
        {"robots.1": TWO | {"name": "b"}, "constraints.separation_m": 3.1},
        "robots[1].start_m",
        "3 m from the start of robot, less than",
    ),
    (
        REACH,
        {
            "robots.1": TWO | {"name": "b", "start_m": [30.0, 25.0], "goal_m": [45.0, 15.0]},
            "constraints.separation_m": 2.0,
        },
        "robots[1].goal_m",
        "0 m from the goal of",
    ),
    # Dynamics
    (LEARN, {"robots.0.dynamics": "double_integrator"}, None, "needs acceleration_max_m_s2"),
    (LEARN, {"robots.0.dynamics": "unicycle"}, None, "needs turn_rate_max_rad_s"),
    (LEARN, {"robots.0.dynamics": "bicycle"}, "=", "single_integrator"),
    *(
        (LEARN, base | {f"robots.0.{key}": value}, None, words)
        for base, key, value, words in (
            ({}, "acceleration_max_m_s2", 1.0, "goes only with dynamics double_integrator"),
            ({}, "start_velocity_m_s", [0, 0], "goes only with dynamics double_integrator"),
            ({}, "start_heading_rad", 1.0, "goes only with dynamics unicycle"),
            (HEAVY, "turn_rate_max_rad_s", 1.0, "goes only with dynamics unicycle"),
            (WHEELS, "acceleration_max_m_s2", 1.0, "goes only with dynamics double_integrator"),
            (HEAVY, "start_velocity_m_s", [1.0, 0.1], "faster than speed_max_m_s"),
            (HEAVY, "acceleration_max_m_s2", 0.0, "more than 0"),
            (WHEELS, "speed_min_m_s", 0.1, "at most 0"),
            (WHEELS, "turn_rate_max_rad_s", 6.3, "full circle"),
        )
    ),
    *(
        (
            LEARN,
            HEAVY | {"robots.0.start_m": start, "robots.0.start_velocity_m_s": velocity},
            "robots[0].start_velocity_m_s",
            words,
        )
        for start, velocity, words in (
            ([18.0, 15.0], [0.9, 0.0], "clear of the obstacles"),
            ([0.5, 5.0], [-0.9, 0.0], "within world.bounds_m"),
        )
    ),
    *(
        (LEARN, WHEELS | {"planner.name": name}, None, "use auto, nlp, scp or lattice")
        for name in ("one_step", "random", "lawnmower")
    ),
    # Rules of connectivity
    *(
        (LEARN, {"constraints": rule}, None, words)
        for rule, words in (
            (RULE | {"connectivity": "average", "outage_max_m": 3.0}, "outage_max_m, which goes"),
            (RULE | {"deadline_s": 3.0}, "deadline_s, which goes only with"),
            ({"connectivity": "joint"}, "needs p_min above 0"),
            ({"connected_times_s": [2]}, "needs p_min above 0"),
            (RULE | {"connectivity": "outage"}, "needs one of outage_max_m and outage_max_s"),
            (
                RULE | {"connectivity": "outage", "outage_max_m": 3.0, "outage_max_s": 3.0},
                "needs one of outage_max_m and outage_max_s",
            ),
            ({"connectivity": "data", "data_mbit": 3.0, "deadline_s": 3.0}, "needs rate_mbit_s"),
            ({"slack_max_db": 1.0}, "p_min is 0"),
            (RULE | {"connectivity": "average", "slack_price": 1.0}, "needs slack_max_db"),
            (RULE | {"connectivity": "joint", "parameter_uncertainty": "all"}, "not for connect"),
            ({"parameter_uncertainty": "all"}, "p_min is 0"),
            (RULE | {"connectivity": "sometimes"}, "each_step"),
            (RULE | {"connectivity": "stated_times", "connected_times_s": [0.5]}, "no multiple"),
            (RULE | {"connectivity": "stated_times", "connected_times_s": [-1.0]}, "than 0"),
            (DATA | {"data_mbit": math.inf}, "finite"),
            (DATA | {"p_min": 0.9999}, "constraints.p_min"),
            (DATA | {"data_mbit": 19.1}, "constraints.data_mbit"),
        )
    ),
    (
        LEARN | LATE,
        {"constraints": RULE | {"connected_times_s": [5.0, 3.5]}},
        "constraints.connected_times_s",
        "begin with 3.5, and a run ends after 3 s",
    ),
]


@pytest.mark.parametrize(("base", "changes", "key", "words"), REFUSED)
def test_it_is_one_error_with_file_key_and_remedy(
    tables: Tables, built: Build, base: Tables, changes: Tables, key: str | None, words: str
) -> None:
    """Only the changes are at fault; "=" stands for the first key that is changed."""
    set_keys(tables, base)
    set_keys(tables, changes)
    with pytest.raises(InputError) as caught:
        built(tables)
    error = caught.value
    if key == "=":
        first, *rest = next(iter(changes)).split(".")
        key = first + "".join(f"[{part}]" if part.isdigit() else f".{part}" for part in rest)
    assert words in str(error)
    assert error.file == "small.toml"
    assert error.remedy or "should" in error.message or "is missing" in error.message
    assert key is None or error.key == key


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
    """The other side of the limits above."""
    set_keys(tables, base)
    set_keys(tables, changes)
    built(tables)
