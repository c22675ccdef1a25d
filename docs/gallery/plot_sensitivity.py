"""
Which parameter is worth learning
=================================

The mean squared error of a predicted map when one of the channel's parameters is wrong: Fig. 1 of
[GM11] (section II-B), computed exactly rather than simulated.
"""

# %%
# The indoor channel of the figure. The seed gives its parameters and the number of measurements,
# 0.1 % of a grid of 320 x 320; neither the side of the room nor the station's place is stated.
# Here the room is 20 m wide and the station stands in its centre.
import numpy as np

from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.sensitivity import sensitivity_curves
from planopt.report.sensitivity_figure import draw_sensitivity
from planopt.world.raster import cell_centres_m

SIDE_M = 20.0
GRID = 320
MEASUREMENTS = 102
station = Station((SIDE_M / 2.0, SIDE_M / 2.0))
channel = ChannelParameters(
    k_pl_db=-10.0,
    n_pl=2.0,
    shadow_std_db=2.0,
    decorrelation_m=1.0,
    multipath_std_db=2.78,
    station=station,
)

# %%
# Measured cells are drawn at random, anew for each of four placements. The average over the
# workspace is taken on every eighth cell of the grid in each direction.
x = cell_centres_m(0.0, SIDE_M, SIDE_M / GRID)
cells = np.stack(np.meshgrid(x, x), axis=-1)
shown = cells[4::8, 4::8].reshape(-1, 2)
generator = np.random.default_rng(0)
errors = np.linspace(-0.5, 0.5, 11)
curves = []
for _ in range(4):
    measured = generator.choice(cells.reshape(-1, 2), MEASUREMENTS, replace=False)
    curves.append(sensitivity_curves(channel, measured, shown, errors.tolist()))
mean = {name: np.mean([curve[name] for curve in curves], axis=0) for name in curves[0]}

# %%
# As in [GM11], the error in the path loss exponent dominates: at 50 % it multiplies the error by
# four. Errors in shadowing and multipath hardly matter, since at this density kriging gains little
# to begin with.
for name, curve in mean.items():
    print(f"{name:20} -50 %: {curve[0]:6.2f}   0: {curve[5]:6.2f}   +50 %: {curve[-1]:6.2f} dB^2")
figure = draw_sensitivity(errors.tolist(), mean)
