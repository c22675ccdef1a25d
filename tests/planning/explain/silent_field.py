"""A field that nothing has been heard of, with known path loss: chances have closed forms.

All fading is multipath: at every place the power is normal about the path loss, with one deviation,
and steps are independent.
"""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import scipy.stats
from terms_scene import SENDING

from planopt import Measurements, Problem
from planopt.channel import Belief, ChannelFit, ChannelParameters, Station, condition
from planopt.problems.problem import problem_from_tables

K_PL_DB, N_PL, DEVIATION_DB = -30.0, 3.0, 5.0

STATION_M, HEIGHT_M = (5.0, 20.0), 3.0
START_M = (35.0, 20.0)
THRESHOLD_DBM = -70.0

TABLES: dict[str, Any] = {
    "problem": {"schema": 1, "name": "silent", "task": "custom"},
    "world": {"bounds_m": [0.0, 0.0, 60.0, 40.0]},
    "channel": {"measurements": {"file": "none.csv"}},
    "robots": [{"start_m": list(START_M), "speed_max_m_s": 2.0}],
    "stations": [
        {
            "position_m": list(STATION_M),
            "height_m": HEIGHT_M,
            "transmit_power_dbm": 0.0,
            "threshold_dbm": THRESHOLD_DBM,
        }
    ],
    "objective": {"terms": [dict(SENDING)]},
    "constraints": {"clearance_m": 0.5},
    "planner": {"step_s": 1.0, "horizon": 5},
}


def silent_problem(horizon: int = 5, **constraints: Any) -> Problem:
    """One robot 30 m from the station, 2 m a step, with these constraints."""
    tables = copy.deepcopy(TABLES)
    tables["planner"]["horizon"] = horizon
    tables["constraints"] |= constraints
    return problem_from_tables(tables, folder=Path(), file=None)


def belief_in(problem: Problem, places_m: np.ndarray, power_dbm: np.ndarray, **own: Any) -> Belief:
    """What these readings tell, with known parameters; `own` in place of the silent field's."""
    known: dict[str, Any] = {
        "k_pl_db": K_PL_DB,
        "n_pl": N_PL,
        "shadow_std_db": 1e-3,
        "decorrelation_m": 1.0,
        "multipath_std_db": DEVIATION_DB,
    }
    site = problem.stations[0].site
    parameters = ChannelParameters(**(known | own), station=Station(site.position_m, site.height_m))
    measured = Measurements(places_m, power_dbm, np.zeros(len(places_m), dtype=bool))
    fit = ChannelFit(
        "reml", "ok", parameters, dict.fromkeys(known, 0.1), np.eye(2), len(places_m), 0, (), 0.0
    )
    return Belief(fit, condition(parameters, measured, theta="known"))


def silent_belief(problem: Problem) -> Belief:
    """Nothing is known but the path loss."""
    return belief_in(problem, np.array([[58.0, 38.0]]), np.array([-90.0]))


def best_chances(steps: int = 5, step_m: float = 2.0, threshold_dbm: float = THRESHOLD_DBM):
    """``(N,)`` chance after each step of driving straight to the station, written out."""
    along = (START_M[0] - STATION_M[0]) - step_m * np.arange(1, steps + 1)
    distance = np.hypot(along, HEIGHT_M)
    mean = K_PL_DB - 10.0 * N_PL * np.log10(distance)
    return scipy.stats.norm.sf(threshold_dbm, mean, DEVIATION_DB)
