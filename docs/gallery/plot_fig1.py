"""
Which parameter is worth learning: Fig. 1 of [GM11]
===================================================

The mean squared error of a predicted map when one of the channel's parameters is wrong (section
II-B). The paper finds that errors in path loss dominate, in the exponent more than in the constant,
and that those in shadowing and multipath hardly matter. The problem ``fig1`` of the library states
what the paper leaves open: the side of the room, 20 m, and the station's place, its centre.
"""

# %%
# First exactly, as the expectation over channels (equation 1.16): the true parameters of ``fig1``,
# and its number of measurements, 0.1 % of a grid of 320 x 320.
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from planopt import load, simulate
from planopt.channel import ChannelParameters, Station, sensitivity_curves
from planopt.report import draw_sensitivity, save_animation

GRID = 320
problem = load("fig1")
given, side_m = problem.channel.given, problem.workspace.bounds_m[2]
channel = ChannelParameters(
    k_pl_db=given.k_pl_db,
    n_pl=given.n_pl,
    shadow_std_db=given.shadow_std_db,
    decorrelation_m=given.decorrelation_m,
    multipath_std_db=given.multipath_std_db,
    station=Station(problem.stations[0].position_m),
)

# %%
# Measured cells are drawn at random, anew for each of four placements. The average over the
# workspace is taken on every eighth cell of the grid in each direction.
x = (np.arange(GRID) + 0.5) * side_m / GRID
cells = np.stack(np.meshgrid(x, x), axis=-1)
shown = cells[4::8, 4::8].reshape(-1, 2)
generator = np.random.default_rng(0)
errors = np.linspace(-0.5, 0.5, 11)
curves = []
for _ in range(4):
    measured = generator.choice(
        cells.reshape(-1, 2), problem.channel.measurements.count, replace=False
    )
    curves.append(sensitivity_curves(channel, measured, shown, errors.tolist()))
mean = {name: np.mean([curve[name] for curve in curves], axis=0) for name in curves[0]}

# %%
# As in [GM11], the error in the path loss exponent dominates: at 50 % it multiplies the error by
# four. Errors in shadowing and multipath hardly matter, since at this density kriging gains little
# to begin with.
for name, curve in mean.items():
    print(f"{name:20} -50 %: {curve[0]:6.2f}   0: {curve[5]:6.2f}   +50 %: {curve[-1]:6.2f} dB^2")
figure = draw_sensitivity(errors.tolist(), mean)

# %%
# Then as runs: ``planopt compare fig1`` draws channels, measures them, and predicts with parameters
# of which one is wrong (the table ``compare`` of the problem; the page of results has its numbers).
# On the same channel the error with the true exponent, and with one that is 50 % too large:
runs = {}
for factor in (1.0, 1.5):
    wrong = replace(given, n_pl=factor * given.n_pl)
    changed = replace(problem, channel=replace(problem.channel, given=wrong))
    runs[factor] = simulate(changed, seed=100)
    print(f"n_PL x {factor}: {runs[factor].metrics['mean_squared_error_db2']:.1f} dB^2")

# %%
# A robot that maps this channel with the true parameters, twenty steps of the same problem.
longer = replace(problem, planner=replace(problem.planner, max_steps=20))
animation = Path(tempfile.mkdtemp()) / "fig1.gif"
save_animation(simulate(longer, seed=100), animation)
