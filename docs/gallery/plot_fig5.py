"""
A target indoors, and what a robot should know: Fig. 5 of [GM11]
================================================================

One robot tracks a target in a building where shadowing decays within a step. The paper measured its
channel there; the problem ``fig5`` draws one with the same parameters. It compares four strategies:
a robot that predicts the channel, one that knows path loss alone, one that takes coverage for a
disc, and one that does not think of communication.
"""

# %%
# All plan one step ahead, as in the paper. Two bounds know what no robot can: the oracle path loss,
# shadowing and where the target will be, the clairvoyant multipath as well.
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from planopt import load, simulate
from planopt.report import draw_run, save_animation

problem = load("fig5")
STYLES = {
    "auto": ("#0072B2", "-"),
    "path_loss_only": ("#009E73", "--"),
    "informed_disk": ("#D55E00", "-."),
    "unaware": ("#CC79A7", ":"),
    "oracle_log": ("#666666", "-"),
    "clairvoyant_log": ("#000000", ":"),
}
SEED = 0
runs = {name: simulate(problem, planner=name, horizon=1, seed=SEED) for name in STYLES}
figure = draw_run(runs["auto"])

# %%
# The trace of the station's covariance of the target's position.
curves, axes = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
for name, (colour, dashes) in STYLES.items():
    run = runs[name]
    axes.plot(run.runs[0].log.t_s, run.target.station_variance_m2, dashes, color=colour, label=name)
axes.set(xlabel="time [s]", ylabel="trace P [m$^2$]", yscale="log")
axes.legend(ncols=2)
for name, run in runs.items():
    print(
        f"{name}: mean trace P {run.metrics['time_averaged_trace_p']:.3f} m^2, "
        f"{run.metrics['delivered']:.0%} delivered"
    )

# %%
# Where shadowing decays within a step, knowing it helps little, and one step ahead it can hurt: the
# robot stays at a place that it knows to be good while the target leaves. The order of the
# strategies changes from world to world; the page of results has means over seeds. A longer
# horizon brings more: time-averaged trace P over seeds 100 to 119 (``planopt compare fig5
# --horizons 1,10 --seeds 100:120``) is .142 +- .019 m^2 one step ahead and .095 +- .007 at ten.

# %%
# In power that was measured in a room by others: ``benchmarks/fig5_lab.py`` (the page of results).
#
# ``planopt compare fig5`` makes the comparison of the figure. One run step by step,
# the robot that predicts the channel
# (``planopt simulate fig5 --animation --out run`` from the command line):
animation = Path(tempfile.mkdtemp()) / "fig5.gif"
save_animation(runs["auto"], animation)
