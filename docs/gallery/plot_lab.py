"""
Where 92 transmitters are, from their power alone
=================================================

A robot drove through a room of 5 by 5.5 m while a Wi-Fi router stood at one of 92 places (Yang et
al., IROS 2024, repository wenhaol/DCM-RSSI, MIT licence). For each place the channel is fitted with
the router's position unknown, both ways of footnote 2 of [GM11], and compared with where it was.

The data are not part of planopt: they are read from the folder ``lab`` of the one that the
variable ``PLANOPT_DATA`` of the environment names, and without them this page has no figure.
"""

# %%
# Which end transmits does not matter: the router is the station, its power is measured along the
# robot's way. Powers are whole dBm. Neither end's height is stated; the fit takes both to be equal.
import os
from pathlib import Path

import numpy as np

from planopt import Measurements
from planopt.channel import fit_channel_and_station
from planopt.report import draw_stations

LAB = Path(os.environ.get("PLANOPT_DATA", "data")) / "lab"
RESOLUTION_DB = 1.0


def read_rounds(folder: Path) -> tuple[np.ndarray, list[Measurements]]:
    """True positions (m, 2), and what was measured with the router at each."""
    true = np.loadtxt(folder / "transmitters.csv", delimiter=",", skiprows=2, usecols=(0, 2, 3))
    log = np.loadtxt(folder / "dcm_rssi.csv", delimiter=",", skiprows=2)
    rounds = []
    for number in true[:, 0]:
        one = log[log[:, 0] == number]
        exact = np.zeros(len(one), dtype=bool)
        resolution_db = np.full(len(one), RESOLUTION_DB)
        rounds.append(Measurements(one[:, 1:3], one[:, 3], exact, resolution_db))
    return true[:, 1:], rounds


# %%
# Without a model one would take the place of the strongest power for the router's. It cannot be far
# off where the robot passed everywhere, as here. The likelihood is nearer for most routers, but
# puts some at the edge outside the room: from there a larger exponent looks much the same. The line
# ignores that shadowing is correlated.
if LAB.is_dir():
    true_m, rounds = read_rounds(LAB)
    joint = [fit_channel_and_station(one) for one in rounds]
    line = [fit_channel_and_station(one, station_method="line") for one in rounds]
    estimates = {
        "joint likelihood": np.array([fit.parameters.station.position_m for fit in joint]),
        "line fit": np.array([fit.parameters.station.position_m for fit in line]),
        "strongest power": np.array([one.positions_m[one.power_dbm.argmax()] for one in rounds]),
    }
    figure = draw_stations(true_m, estimates, np.concatenate([r.positions_m for r in rounds]))
else:
    print("The lab data are not there: no figure.")

# %%
# Are the stated uncertainties right? The true place should be inside the 95 % ellipse 95 times out
# of 100; it is less often, since a room is not the model. Where the measurements do not bound the
# position the fit says so, and it is counted apart.
CHI_SQUARED_95 = 5.991
if LAB.is_dir():
    for name, fits in (("joint likelihood", joint), ("line fit", line)):
        covariances = [fit.station_covariance_m2 for fit in fits]
        bounded = np.array([np.isfinite(covariance).all() for covariance in covariances])
        off = (estimates[name] - true_m)[bounded]
        ellipses = np.array(covariances)[bounded]
        normed = np.einsum("ni,nij,nj->n", off, np.linalg.inv(ellipses), off)
        print(
            f"{name:17} {np.mean(normed < CHI_SQUARED_95):.0%} of {bounded.sum()} inside; "
            f"not bounded: {np.sum(~bounded)}"
        )
    for name, found in estimates.items():
        error_m = np.hypot(*(found - true_m).T)
        print(
            f"{name:17} median {np.median(error_m):.2f} m, 90 % {np.quantile(error_m, 0.9):.2f} m"
        )
