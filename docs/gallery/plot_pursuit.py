"""
A pursuer that knows old news
=============================

A grid of radio motes reports an evader: fresh and exact where it is near, old and coarse where it
is far. The first picture is what the motes know, the second a pursuit among buildings with the age
of what the pursuer goes by, the third the network of least power for which capture is guaranteed.
"""

# %%
# What every mote knows of an evader that has driven east at 1 m/s. A mote takes the finest level
# whose last finished round shows the evader near it; the age of its report is that level's.
import numpy as np

from planopt import load_system
from planopt.pursuit.knowledge import Track, snapshot
from planopt.pursuit.service import SnapshotService
from planopt.report.pursuit_design_figure import draw_design
from planopt.report.pursuit_figure import draw_knowledge, draw_pursuit

service = SnapshotService(levels=7, mote_spacing_m=1.0, frame_s=0.1, bits_per_axis=4)
track = Track(np.array([0.0, 60.0]), np.array([[20.0, 48.0], [80.0, 48.0]]))
draw_knowledge(snapshot(service, track, 60.0), track)

# %%
# A pursuit among obstacles: the pursuer drives to the reported place by the shortest path, and asks
# again there. The report's age grows until then.
problem = load_system("pursuit_obstacles")
run = problem.simulate(seed=1)
print("\n".join(run.words))
draw_pursuit(problem.name, run.result.pursuit)

# %%
# The network of least power whose snapshots guarantee capture within five minutes: power by slot
# width and bits, what a quantity is worth, and energy against time to capture.
design = load_system("pursuit_design").solve()
print("\n".join(design.words))
draw_design(design.result.task, design.data)
