"""Reference results of every task through the public API.

``python tests/golden/golden_cases.py`` lists what differs from ``golden_cases.json``;
``python tests/golden/golden_cases.py --write [NAME...]`` computes the references of all cases, or
of those named, again. References change in commits of their own, whose message lists each number
and its reason.

Each case names a function below and its arguments. Numbers agree within 0.1 % (`SHARE`), far above
what rounding changes on other processors; all other values agree exactly. A better verdict is no
difference.
"""

import contextlib
import io
import json
import math
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import planopt
from planopt import channel, problems
from planopt.cli import main

REFERENCES = Path(__file__).with_name("golden_cases.json")
LIBRARY = Path(__file__).parents[2] / "problems"
SHARE = 1e-3
SMALL = 1e-6

RUN_METRICS = (
    *("path_m", "predicted_min_connectivity", "measured_steps", "realised_cost_m"),
    *("time_averaged_trace_p", "trace_m_db", "rms_db", "goal_time_s"),
)
ANSWER_KEYS = (
    *("verdict", "outcome", "objective", "bound", "capture_time_s", "termination", "metrics"),
    *("cost_w", "frame_s", "bits_per_axis", "slot_width_s", "verified_rate"),
)


def edited(name: str, edits: Mapping[str, Any]) -> planopt.Problem:
    """A library problem with other values of dotted keys."""
    tables = problems.problem_to_dict(planopt.load(name))
    for dotted, value in edits.items():
        *path, last = dotted.split(".")
        table: Any = tables
        for part in path:
            table = table[int(part)] if part.isdigit() else table.setdefault(part, {})
        table[int(last) if last.isdigit() else last] = value
    return problems.problem_from_dict(tables, file=LIBRARY / f"{name}.toml")


def plan(name: str, edits: Mapping[str, Any] | None = None, **settings: Any) -> dict[str, Any]:
    try:
        found = planopt.solve(edited(name, edits or {}), **settings)
    except planopt.NoPlanError:
        return {"verdict": "none"}
    return {
        "verdict": found.verdict.value,
        "objectives": [each.objective for each in found.plans],
        "min_connectivity": [float(each.connectivity.min()) for each in found.plans],
        "senses": [each.sense for each in found.plans],
        "states": [len(each.next_state) for each in found.plans],
    }


def run(name: str, edits: Mapping[str, Any] | None = None, **settings: Any) -> dict[str, Any]:
    """The first steps of a closed loop."""
    short = {"planner.max_steps": 4, **(edits or {})}
    made = planopt.simulate(edited(name, short), **settings)
    return {
        "outcome": made.outcome.value,
        "verified_rate": made.verified_rate,
        "objectives": [float(np.mean([one.objective for one in each])) for each in made.plans],
        **{key: made.metrics[key] for key in RUN_METRICS if key in made.metrics},
    }


def own_loop(name: str, states: Sequence[Sequence[float]], **settings: Any) -> dict[str, Any]:
    """Plans of a user's own loop that comes by given positions."""
    planner = planopt.Planner(edited(name, {}), **settings)
    plans = [planner.step(state) for state in states]
    return {
        "verdicts": [each.verdict.value for each in plans],
        "objectives": [each.objective for each in plans],
    }


def fit(name: str, method: str) -> dict[str, Any]:
    """Channel parameters fitted to a problem's measurements, and a prediction."""
    problem = planopt.load(name)
    known = planopt.Planner(problem).beliefs[0].posterior
    station = channel.Station(np.asarray(known.parameters.station.position_m))
    found = channel.fit_channel(known.measurements, station, method).parameters
    centre = np.reshape(problem.workspace.bounds_m, (2, 2)).mean(axis=0)
    predicted = channel.condition(found, known.measurements).predict([centre])
    return {
        "k_pl_db": found.k_pl_db,
        "n_pl": found.n_pl,
        "shadow_std_db": found.shadow_std_db,
        "decorrelation_m": found.decorrelation_m,
        "multipath_std_db": found.multipath_std_db,
        "mean_db": predicted.mean_db.tolist(),
        "deviation_db": predicted.deviation_db.tolist(),
    }


def comparison(name: str, edits: Mapping[str, Any] | None = None, **settings: Any) -> Any:
    """Means and paired ratios of a comparison."""
    made = planopt.compare(edited(name, {"planner.max_steps": 3, **(edits or {})}), **settings)
    return {
        f"{row.planner} {row.horizon} {row.metric}": [row.mean, row.paired_ratio]
        for row in made.rows
        if row.metric in RUN_METRICS
    }


def command(*arguments: str) -> dict[str, Any]:
    """What a command prints as JSON, and its exit code; ``OUT`` is a temporary folder."""
    with tempfile.TemporaryDirectory() as out, contextlib.redirect_stdout(io.StringIO()) as text:
        code = main([*(each.replace("OUT", out) for each in arguments), "--json"])
    data = json.loads(text.getvalue())
    return {"exit_code": code, **{key: data[key] for key in ANSWER_KEYS if key in data}}


def system(action: str, name: str, *changes: str) -> dict[str, Any]:
    """A command for a library problem in which lines that set a key are replaced by `changes`."""
    lines = (LIBRARY / f"{name}.toml").read_text(encoding="utf-8").splitlines()
    for change in changes:
        key = change.split("=")[0]
        at = next(number for number, line in enumerate(lines) if line.startswith(key))
        lines[at] = change
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{name}.toml"
        file.write_text("\n".join(lines), encoding="utf-8")
        return command(action, str(file))


RULE = "constraints.connectivity"
WALLS = [{"name": "wall", "polygon": [[56.0, 0.0], [64.0, 0.0], [64.0, 100.0], [56.0, 100.0]]}]
COURIERS = [
    {"name": "a", "start_m": [32.0, 30.0], "goal_m": [88.0, 30.0], "speed_max_m_s": 2.0},
    {"name": "b", "start_m": [36.0, 30.0], "goal_m": [94.0, 30.0], "speed_max_m_s": 2.0},
]
SWAP = [
    {"name": "a", "start_m": [30.0, 8.0], "goal_m": [42.0, 8.0], "speed_max_m_s": 2.0},
    {"name": "b", "start_m": [42.0, 8.0], "goal_m": [30.0, 8.0], "speed_max_m_s": 2.0},
]
WALKS = str(LIBRARY / "data" / "munich_walks.csv")
CASES: dict[str, tuple[Any, ...]] = {
    # Reach: several worlds, costs-to-go, planners, and no plan
    "reach open field": (plan, "open_field"),
    "reach open field geodesic": (plan, "open_field", {"objective.cost_to_go": "geodesic"}),
    "reach city": (plan, "munich_courier"),
    "reach by lattice": (plan, "two_station_courier", {"planner.name": "lattice"}),
    "reach by convex programs": (plan, "two_station_courier", {"planner.name": "scp"}),
    "reach behind walls": (plan, "open_field", {"world.obstacles": WALLS}),
    "reach out of coverage": (plan, "munich_long_hole"),
    "reach run": (run, "open_field", {"planner.max_steps": 60}),
    "reach run two stations": (run, "two_station_courier"),
    "reach own loop": (own_loop, "open_field", [[32.0, 30.0], [28.3, 28.5], [24.7, 27.0]]),
    # Couriers that keep their distance, and dynamics
    "couriers": (run, "open_field", {"robots": COURIERS, "constraints.separation_m": 3.0}),
    "couriers give way": (run, "open_field", {"robots": SWAP, "constraints.separation_m": 3.0}),
    "reach with double integrator": (plan, "harbour_reach"),
    "reach run with double integrator": (run, "harbour_reach"),
    # Rules
    "rule average": (plan, "outdoor_map", {RULE: "average", "constraints.p_min": 0.9995}),
    "rule joint": (plan, "outdoor_map", {RULE: "joint", "constraints.p_min": 0.998}),
    "rule outage": (plan, "two_station_courier", {RULE: "outage", "constraints.outage_max_m": 9.0}),
    "rule stated times": (
        plan,
        "outdoor_map",
        {"constraints.p_min": 0.9999, "constraints.connected_times_s": [2.0, 4.0]},
    ),
    # Tracking
    "track": (plan, "fig4"),
    "track run": (run, "fig4"),
    "track one robot": (run, "outdoor_track"),
    "track moving obstacles": (run, "crowded_track"),
    "track with dynamics": (plan, "harbour_track"),
    "track among traffic": (plan, "harbour_traffic"),
    # Learning, mapping, connecting, sums
    "learn": (plan, "indoor_learn"),
    "learn run": (run, "fig2"),
    "learn one step": (run, "fig2", {"planner.name": "one_step", "planner.horizon": 1}),
    "map": (plan, "outdoor_map"),
    "map run": (run, "outdoor_map"),
    "map run lawnmower": (run, "outdoor_map", {"planner.name": "lawnmower"}),
    "map fig3": (run, "fig3"),
    "connect": (plan, "connect_rooftop"),
    "connect run": (run, "connect_street"),
    "sum of terms": (plan, "scout_courier"),
    "sum of terms run": (run, "scout_courier"),
    # Fits
    "fit reml": (fit, "outdoor_map", "reml"),
    "fit convex": (fit, "outdoor_map", "convex"),
    "fit nls": (fit, "outdoor_map", "nls"),
    "fit lemma1": (fit, "outdoor_map", "lemma1"),
    "fit capped": (fit, "outdoor_map", "capped"),
    # Comparisons
    "compare horizons": (comparison, "outdoor_map", {}, {"horizons": [2, 4], "seeds": 2}),
    "compare planners": (
        comparison,
        "open_field",
        {"planner.max_steps": 60},
        {"planners": ["auto", "lattice"], "costs_to_go": ["connected"], "seeds": 1},
    ),
    # Networks: coverage, events, pursuit, design
    "coverage": (system, "simulate", "coverage_plain", "duration_s = 20"),
    "coverage obstacles": (system, "simulate", "coverage_obstacles", "duration_s = 10"),
    "coverage radio": (system, "simulate", "coverage_radio", "duration_s = 10"),
    "event response": (system, "simulate", "event_response", "duration_s = 80"),
    "several events": (system, "simulate", "events_several", "duration_s = 70"),
    "pursuit static": (command, "simulate", "pursuit_static"),
    "pursuit fleeing": (command, "simulate", "pursuit_fleeing"),
    "pursuit obstacles": (command, "simulate", "pursuit_obstacles"),
    "pursuit several": (command, "simulate", "pursuit_several"),
    "pursuit design": (command, "solve", "pursuit_design"),
}
"""Function, its arguments, and its keyword arguments if the last one is a second dictionary."""


def result(name: str) -> dict[str, Any]:
    """Compute a case; values as JSON has them, NaN as None."""
    function, *arguments = CASES[name]
    settings: dict[str, Any] = {}
    if function is comparison:
        settings = arguments.pop()
    return _plain(function(*arguments, **settings))


def differences(reference: Any, now: Any, where: str = "") -> list[str]:
    """Describe the values that differ beyond the tolerance; empty if none does."""
    if isinstance(reference, dict) and isinstance(now, dict):
        return [
            words
            for key in {**reference, **now}
            for words in differences(reference.get(key), now.get(key), f"{where} {key}".strip())
        ]
    if isinstance(reference, list) and isinstance(now, list) and len(reference) == len(now):
        pairs = enumerate(zip(reference, now, strict=True))
        return [
            words for number, both in pairs for words in differences(*both, f"{where} {number}")
        ]
    if reference == now or (where.startswith("verdict") and now == "verified"):
        return []
    numbers = all(isinstance(each, float) for each in (reference, now))
    if numbers and math.isclose(reference, now, rel_tol=SHARE, abs_tol=SMALL):
        return []
    return [f"{where}: {reference} is now {now}"]


def read_references() -> dict[str, Any]:
    return json.loads(REFERENCES.read_text(encoding="utf-8"))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float):
        return float(f"{value:.9g}") if math.isfinite(value) else None
    return value


def _write(names: Sequence[str]) -> None:
    known = {name: found for name, found in read_references().items() if name in CASES}
    known |= {name: result(name) for name in names or CASES}
    lines = [f"{json.dumps(name)}: {json.dumps(known[name])}" for name in CASES]
    REFERENCES.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--write"]:
        _write(sys.argv[2:])
        sys.exit()
    known = read_references()
    found = [
        f"{name}: {words}" for name in CASES for words in differences(known[name], result(name))
    ]
    print("\n".join([*found, f"{len(found)} differences"]))
    sys.exit(bool(found))
