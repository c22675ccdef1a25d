"""
A target that leaves coverage: Fig. 4 of [GM11]
===============================================

Three robots follow a target that walks out of the station's coverage. The paper plans one step
ahead and finds that robots that know the channel stay connected while others lose the target. It
does not say where station, robots and target start, nor how large the workspace is: the problem
``fig4`` of the library states one choice, and draws the starts with the random seed.
"""

# %%
# One step ahead, as in the paper (its criterion (4), the form ``additive``), and ten steps ahead by
# the form ``recourse``: the end of a path is a place that is tried. A robot that has no connection
# there goes back, so that a step out of what is known to be covered costs little, and may bring a
# place that is connected from then on.
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from planopt import load, simulate
from planopt.report import draw_run, save_animation

problem = load("fig4")
SETTINGS = {"one step, additive": 1, "ten steps, recourse": 10}
SEED = 103
runs = {name: simulate(problem, horizon=ahead, seed=SEED) for name, ahead in SETTINGS.items()}

# %%
# The longer horizon goes farther with the target: robots try places, and go back.
figure = draw_run(runs["ten steps, recourse"])

# %%
# One step ahead, the same world: the robots stay where they are surely heard.
short_figure = draw_run(runs["one step, additive"])

# %%
# The trace of the station's covariance of the target's position, from the same first estimate.
curves, axes = plt.subplots(figsize=(7.0, 3.5), layout="constrained")
for (name, run), (colour, dashes) in zip(
    runs.items(), (("#0072B2", "-"), ("#D55E00", "--")), strict=True
):
    axes.plot(run.runs[0].log.t_s, run.target.station_variance_m2, dashes, color=colour, label=name)
axes.set(xlabel="time [s]", ylabel="trace P [m$^2$]", yscale="log")
axes.legend()
for name, run in runs.items():
    print(
        f"{name}: mean trace P {run.metrics['time_averaged_trace_p']:.3f} m^2, at the end "
        f"{run.metrics['final_trace_p']:.3f} m^2, {run.metrics['delivered']:.0%} delivered"
    )

# %%
# One world is no comparison, and this one was chosen because the difference is large. Time-averaged
# trace P of the default planner over seeds 100 to 199 (``planopt compare fig4 --horizons 1,10
# --seeds 100:200``): one step .169 +- .024 m^2, ten steps .095 +- .013, no target lost. The form
# ``auto``, the default, is ``additive`` one step ahead and ``recourse`` beyond. The paper's order
# of the four strategies is not robust: the page of results has their means.

# %%
# ``planopt compare fig4`` makes the comparison of the figure. One run step by step,
# the longer horizon (``planopt simulate fig4 --animation --out run`` from the command line):
animation = Path(tempfile.mkdtemp()) / "fig4.gif"
save_animation(runs["ten steps, recourse"], animation)
