"""
A pursuer that knows old news
=============================

A grid of radio motes reports evaders: fresh and exact where they are near, old and coarse where
they are far. The pictures show what one mote knows, what all motes know of one evader, a pursuit
with what the pursuers went by, and the network of least power for which capture is guaranteed.
"""

# %%
# The snapshot of one mote. Squares of doubling size around it are the levels: what stands there is
# reported with that level's age, to a sub-cell of that level's size. Each object has moved on.
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import planopt
from planopt.pursuit import SnapshotService, Track, snapshot
from planopt.report import animate_pursuit, draw_design, draw_pursuit

service = SnapshotService(levels=7, mote_spacing_m=1.0, frame_s=0.1, bits_per_axis=3)
ways_m = [[[20, 48], [80, 48]], [[125, 60], [65, 100]], [[60, 5], [60, 15]], [[20, 90], [20, 110]]]
tracks = [Track(np.array([0.0, 60.0]), np.array(way_m, dtype=float)) for way_m in ways_m]
mote = np.array([66, 50])


def draw_ages(ages_s, title):
    """Draw an age at every mote."""
    figure, axes = plt.subplots(figsize=(7.0, 6.0), layout="constrained")
    extent = (0.0, service.side_m, 0.0, service.side_m)
    image = axes.imshow(ages_s, origin="lower", extent=extent, cmap="cividis")
    figure.colorbar(image, label="age [s]")
    axes.set(title=title, xlabel="x [m]", ylabel="y [m]")
    return figure, axes


# A level that shows one mote to another also shows the reverse.
at_mote = snapshot(service, Track(np.zeros(1), (mote[None] + 0.5) * service.mote_spacing_m), 60.0)
view, axes = draw_ages(at_mote.ages_s[at_mote.level_map()], "snapshot at one mote")
axes.plot(*at_mote.sampled_m[0], "s", color="tab:blue", label="mote")
for number, track in enumerate(tracks):
    now = snapshot(service, track, 60.0)
    level = now.shown_at(mote).argmax()
    since = np.array([now.sampled_m[level], track.positions_m[-1]])
    half_m = service.error_bound_m(level) / np.sqrt(2.0)
    low = now.reported_m[level] - half_m
    axes.add_patch(plt.Rectangle(low, 2.0 * half_m, 2.0 * half_m, fill=False, color="tab:orange"))
    axes.plot(*since.T, color="tab:red", marker="o", markevery=[-1])
    if number == 0:
        axes.patches[0].set_label("report and its error bound")
        axes.lines[-1].set_label("object, moved since the report")
axes.legend()

# %%
# What every mote knows of the first of them, which has driven east at 1 m/s. A mote takes the
# finest level whose last finished round shows the object near it, and has its age.
now = snapshot(service, tracks[0], 60.0)
known, axes = draw_ages(now.ages_s[now.level_map()], "latest report at each mote")
axes.plot(*tracks[0].positions_m.T, color="tab:red", label="path of the object")
axes.plot(*now.reported_m.T, "o", color="tab:orange", label="reported positions")
axes.legend()

# %%
# A pursuit in open space: pursuers drive to the reported place, and ask again there. The report's
# age grows until then.
problem = planopt.load("pursuit_several")
run = planopt.simulate(problem, seed=1)
print("\n".join(run.words))
driven = draw_pursuit(problem.name, run.value)

# %%
# The same pursuit step by step: circles are what each pursuer goes by, crosses where that evader
# was when it was seen.
moving = Path(tempfile.mkdtemp()) / "pursuit.gif"
animate_pursuit(problem.name, run.value, moving)

# %%
# The network of least power whose snapshots guarantee capture within five minutes: power by slot
# width and bits, what a quantity is worth, and energy against time to capture.
design = planopt.solve(planopt.load("pursuit_design"))
print("\n".join(design.words))
chart = draw_design(design.problem.design, design.data)
