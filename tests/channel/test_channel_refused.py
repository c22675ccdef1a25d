"""Calls of planopt.channel with wrong arguments: each is one error of the table of messages."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from refusals import refused
from simulated_channel import simulated

from planopt.channel import (
    ChannelParameters,
    JointPrediction,
    Measurements,
    Station,
    Traffic,
    condition,
    delivered_data,
    first_passage,
    fit_channel,
    fit_channel_and_station,
    held_out_report,
    joint_prediction,
    longest_outage,
    marginalise,
    mean_squared_error_db2,
    multipath_of,
    posterior_map,
    scattered_field_db,
    shadow_field_db,
)
from planopt.channel.calibration import grouped_ratio, reliability
from planopt.channel.cholesky import semidefinite_factor
from planopt.channel.held_out import deal, held_out_predictions
from planopt.channel.joint import SampledDistribution
from planopt.channel.measurements import as_measurements, as_received
from planopt.channel.parameter_uncertainty import perturbed
from planopt.channel.posterior import at_time

NAN, INF = math.nan, math.inf
STATION = Station((50.0, 50.0))
CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, STATION)
DATA = simulated(CHANNEL, 4, 40, 200.0)
LIMITS = replace(DATA, censored=np.ones(40, dtype=bool))
ONE = Measurements(np.ones((1, 2)), np.zeros(1), np.zeros(1, dtype=bool))
PATH = np.column_stack([np.arange(7.0), np.zeros(7)])
TIMES = np.arange(7.0) * 1.5
POSTERIOR = condition(CHANNEL, DATA)
FORGETFUL = condition(replace(CHANNEL, forgetting_s=60.0), DATA)
COLUMNS = {"x_m": [1.0], "y_m": [1.0], "power_dbm": [1.0]}
BOX = (0.0, 0.0, 5.0, 5.0)
PLACES = (np.zeros(2), np.zeros((2, 3)), [[NAN, 0.0]], [[1e160, 0.0]], ["a", "b"], None, [[{}, {}]])
LINE = np.outer(np.arange(40.0), [1.0, 2.0])


def rng():
    return np.random.default_rng(0)


def outage(positions=PATH, times=TIMES, threshold=-80.0, count=10):
    return longest_outage(POSTERIOR, positions, times, threshold, count, rng())


def delivered(deadline):
    return delivered_data(POSTERIOR, PATH, TIMES, -80.0, Traffic(1.0), deadline, 10, rng())


def taken(positions=(1, 2), power=1, censored=1, at=0.0, value=0.0):
    shapes = np.full(positions, at), np.full(power, value), np.zeros(censored, dtype=bool)
    return Measurements(*shapes)


REFUSED = {
    "parameters": [
        partial(replace, CHANNEL, **{name: value})
        for name, values in {
            "k_pl_db": [NAN],
            "n_pl": [INF],
            "shadow_std_db": [-1.0, NAN],
            "decorrelation_m": [0.0, INF],
            "multipath_std_db": [-1.0],
            "forgetting_s": [0.0, NAN],
        }.items()
        for value in values
    ],
    "station": [
        partial(Station, position, height)
        for position, height in [((NAN, 0), 0), ((0, INF), 0), ((0, 0), NAN), ((1e160, 0), 0)]
    ],
    "shapes": [
        partial(taken, *shapes)
        for shapes in [((3, 2), 2, 2), ((2, 3), 2, 2), ((2, 2), 2, 3), ((2,), 2, 2)]
    ],
    "numbers": [
        *(partial(taken, value=bad) for bad in (NAN, INF, -INF, -1e160)),
        *(partial(taken, at=bad) for bad in (NAN, INF, -INF, 1e160)),
    ],
    "optional columns": [
        *(
            partial(replace, ONE, **{name: np.zeros(2)})
            for name in ("resolution_db", "position_std_m", "time_s", "receiver")
        ),
        *(partial(replace, ONE, resolution_db=np.array([bad])) for bad in (-1.0, NAN)),
        *(partial(replace, ONE, position_std_m=np.array([bad])) for bad in (-0.1, INF)),
        partial(replace, ONE, time_s=np.array([NAN])),
    ],
    "tables": [
        partial(as_measurements, table)
        for table in [
            {"x_m": [1.0], "power_dbm": [1.0]},
            COLUMNS | {"y_m": [[1.0]]},
            COLUMNS | {"x_m": [1.0, 2.0]},
            COLUMNS | {"x_m": ["1"]},
            COLUMNS | {"x_m": [None]},
            COLUMNS | {"power_dbm": [1j]},
            COLUMNS | {"power_dbm": [[1.0], [2.0, 3.0]]},
            COLUMNS | {"censored": [2]},
            COLUMNS | {"censored": ["0"]},
            COLUMNS | {"receiver": [0.5]},
            COLUMNS | {"time_s": [1.0, 2.0]},
            3,
            [1.0, 2.0],
            None,
        ]
    ],
    "received": [partial(as_received, COLUMNS | {"power_dbm": [p]}) for p in (-300.1, 100.1)],
    "places": [
        *(partial(POSTERIOR.predict, places) for places in PLACES),
        *(partial(POSTERIOR.connectivity, places, -80.0) for places in PLACES[:4]),
        partial(condition(CHANNEL, DATA, exact_limit=2).predict, PLACES[2]),
        partial(POSTERIOR.connectivity, [[1.0, 2.0]], NAN),
        partial(marginalise(CHANNEL, DATA).predict, np.zeros(3)),
        *(partial(joint_prediction, POSTERIOR, places) for places in PLACES[:3]),
        partial(joint_prediction, POSTERIOR, np.zeros((0, 2))),
    ],
    "joint": [
        partial(JointPrediction, np.zeros(0), np.zeros((0, 0))),
        partial(JointPrediction, np.zeros(2), np.eye(3)),
        partial(JointPrediction, np.array([INF]), np.eye(1)),
        partial(JointPrediction, np.zeros(1), np.array([[NAN]])),
    ],
    "covariance": [
        partial(semidefinite_factor, np.array(matrix))
        for matrix in ([[1.0, 2.0], [2.0, 1.0]], [[-1.0]], [[0.0, 1], [1, 0.0]])
    ],
    "factor": [
        partial(joint_prediction, condition(CHANNEL, DATA, exact_limit=39), PATH),
        partial(condition, CHANNEL, DATA, theta="least_squares", exact_limit=39),
        partial(marginalise, CHANNEL, DATA.take(slice(0))),
        partial(at_time, FORGETFUL, NAN),
    ],
    "fit": [
        partial(fit_channel, DATA, STATION, "magic"),
        partial(fit_channel, DATA, STATION, "convex", loss="cauchy"),
        partial(fit_channel, DATA, STATION, "reml", loss="huber"),
        partial(fit_channel, DATA.take(slice(0)), STATION),
        partial(fit_channel_and_station, DATA, station_method="guess"),
        partial(fit_channel_and_station, DATA.take(slice(7))),
        partial(fit_channel_and_station, replace(DATA, positions_m=LINE)),
        partial(fit_channel_and_station, replace(DATA, positions_m=np.ones((40, 2)))),
        partial(fit_channel_and_station, replace(DATA, power_dbm=np.full(40, -70.0))),
    ],
    "multipath": [
        partial(multipath_of, kind, **number)
        for kind, number in [
            ("rician", {}),
            ("rician", {"m": 3.0, "k": 2.0}),
            ("rayleigh", {"k": 0.0}),
            ("rician", {"m": 0.8}),
            ("rician", {"k": -1.0}),
            ("nakagami", {"k": INF}),
            ("rician", {"m": NAN}),
            ("rician", {"std_db": NAN}),
            ("nakagami", {"std_db": 0.0}),
            ("rician", {"std_db": 5.6}),
            ("nakagami", {"std_db": 9.7}),
            ("nakagami", {"m": NAN}),
            ("lognormal", {"std_db": -1.0}),
        ]
    ],
    "fields": [
        *(
            partial(shadow_field_db, (4, 4), cell, std, beta, rng())
            for std, beta, cell in [
                (-1.0, 5.0, 1.0),
                (NAN, 5.0, 1.0),
                (4.0, 0.0, 1.0),
                (4.0, INF, 1.0),
                (4.0, 5.0, 0.0),
            ]
        ),
        *(
            partial(scattered_field_db, np.zeros((2, 2)), std, beta, rng())
            for std, beta in [(-1.0, 5.0), (NAN, 5.0), (4.0, 0.0), (4.0, INF)]
        ),
    ],
    "maps": [
        *(
            partial(posterior_map, POSTERIOR, bounds, cell, -72.0)
            for bounds, cell in [
                ((0.0, 0.0, 0.0, 5.0), 1.0),
                ((0.0, 0.0, 5.0, NAN), 1.0),
                (BOX, 0.0),
                (BOX, INF),
                ((0.0, 0.0, 5000.0, 5000.0), 0.1),
            ]
        ),
        *(partial(posterior_map, POSTERIOR, BOX, 1.0, threshold) for threshold in (NAN, -INF)),
    ],
    "paths": [
        partial(outage, positions=PATH[:1]),
        partial(outage, times=TIMES[:-1]),
        partial(outage, times=TIMES[::-1]),
        partial(outage, times=np.where(TIMES > 5.0, NAN, TIMES)),
        partial(outage, threshold=NAN),
        partial(outage, count=1),
        partial(outage, count=0),
        *(partial(delivered, deadline) for deadline in (-1.0, 9.5, NAN)),
        *(
            partial(Traffic, *numbers)
            for numbers in [(0.0,), (1, -1.0), (1, 0, -1.0), (1, 5, 0, 4.0), (1, 0, 0, NAN)]
        ),
        *(partial(SampledDistribution, draws) for draws in (np.zeros(1), np.zeros((3, 2)))),
        partial(first_passage, POSTERIOR, PATH, -1000.0, rng(), disconnected_now=True),
    ],
    "sensitivity": [
        *(partial(perturbed, CHANNEL, *error) for error in [("beta", 0.1), ("n_pl", NAN)]),
        partial(perturbed, CHANNEL, "n_pl", -1.0),
        # Before memory is allocated: 60,000 measurements would take 29 GB a matrix.
        partial(mean_squared_error_db2, CHANNEL, CHANNEL, np.zeros((60_000, 2)), PATH),
    ],
    "validation": [
        *(
            partial(grouped_ratio, np.array(over), np.array(under))
            for over, under in [([1.0], [2.0]), ([0.0, 0.0], [0.0, 0.0]), ([], [])]
        ),
        partial(reliability, np.zeros(3), np.zeros(2, dtype=bool), np.zeros(3, dtype=int)),
        partial(deal, np.array([0, 1, 2, 2]), 1, rng()),
        partial(deal, np.array([0, 1, 2, 2]), 4, rng()),
        partial(held_out_predictions, DATA, np.zeros(40, int), lambda _: {}),
        partial(held_out_predictions, DATA, np.arange(3), lambda _: {}),
        partial(held_out_report, DATA, np.zeros(3, int), np.zeros(40, int), dict),
    ],
}


@pytest.mark.parametrize("subject", REFUSED)
def test_channel_refused(subject):
    for call in REFUSED[subject]:
        with refused():
            call()
