"""
Networks that cover a region and answer events
==============================================

Agents spread over a region, answer events and keep their links. Five pictures: rooms covered by
shortest paths; a leak and its end; plans against the laws, with and without limits of acceleration;
coverage that stays connected against coverage that does not; and what a step costs.
"""

# %%
# Rooms. Cells are those of shortest paths, so that nobody covers what is behind a wall; agents come
# from one corner and keep a clearance.
import tempfile
from pathlib import Path
from time import process_time

import matplotlib.pyplot as plt
import numpy as np
import shapely

import planopt
from planopt.coverage.control.movers import Gains, coverage_aims, law_moves, plan_moves
from planopt.coverage.ground import ConvexGround
from planopt.coverage.limits import Motion, MoveLimits
from planopt.coverage.voronoi import convex_region
from planopt.problems import problem_from_dict, problem_to_dict
from planopt.report import animate_network
from planopt.tasks.coverage import picture

rooms = planopt.simulate(planopt.load("coverage_obstacles"), seed=1)
rooms_figure = rooms.plot()

# %%
# A leak appears after 60 s and ends after 180 s. Six agents of forty answer: they count themselves
# over lossy links, agree on the nearest by passing flags, locate the leak on their way, and return.
leak = planopt.simulate(planopt.load("event_response"), seed=1)
print("\n".join(leak.words))
leak_figure = leak.plot()
moving = Path(tempfile.mkdtemp()) / "leak.gif"
animate_network(picture(leak), moving)

# %%
# Plans against the laws: 30 agents spread from a corner. Under a speed limit alone, the mean
# cost of plans over 10 steps is 1 to 2 % below that of the law. With 0.25 m/s^2 agents are slower,
# and plans over 10 steps cost 4 to 6 % less than plans over one step (six seeds).
tables = problem_to_dict(planopt.load("coverage_plain"))
tables["control"] |= {"duration_s": 60.0, "stop_when_settled": False}
runs = {}
for word, more, planner, horizon in (
    ("law, speed limit", {}, "law", 1),
    ("10 steps, speed limit", {}, "receding", 10),
    ("1 step, acceleration limit", {"acceleration_max_m_s2": 0.25}, "receding", 1),
    ("10 steps, acceleration limit", {"acceleration_max_m_s2": 0.25}, "receding", 10),
):
    agents = tables["agents"] | {"speed_max_m_s": 2.0} | more
    planned = {"name": planner, "horizon": horizon}
    changed = problem_from_dict(tables | {"agents": agents, "planner": planned})
    run = planopt.simulate(changed, seed=3).value
    runs[word] = run
    print(f"{word}: mean H {run.costs.mean():.5g}, last {run.costs[-1]:.5g}")
costs_figure, axes = plt.subplots(figsize=(7.0, 4.4), layout="constrained")
for word, run in runs.items():
    axes.semilogy(run.times_s[:-1], run.costs, label=word)
axes.set(title="coverage cost H", xlabel="time [s]", ylabel="H [m$^4$ x density]")
axes.legend()

# %%
# Radio. Every agent keeps its way to the base station with probability 0.95, over links of a tree.
# The laws cover better, and lose the links: crosses mark agents that no way connects well enough.
radio = planopt.load("coverage_radio")
kept = planopt.simulate(radio)
by_law = planopt.simulate(radio, planner="law")
print(f"H at the end: {kept.value.costs[-1]:.4g} connected, {by_law.value.costs[-1]:.4g} not")
kept_figure = kept.plot()
lost_figure = by_law.plot()

# %%
# What a step costs: processor time of the laws, and of plans ten steps ahead for single and double
# integrators with bodies, on their way to their centroids and all on their way to one place.
times_s, sizes = {}, (30, 100, 300, 1000)
for number in sizes:
    side = 10.0 * np.ceil(np.sqrt(number))
    ground = ConvexGround(convex_region(shapely.box(0, 0, side, side)))
    at = np.arange(5.0, side, 10.0)
    places = np.stack(np.meshgrid(at, at), axis=2).reshape(-1, 2)[:number]
    places = places + 3.0 * np.random.default_rng(0).random(places.shape)
    nobody = np.zeros(number, dtype=bool)
    inert = {"acceleration_m_s2": 1.0}
    jobs = {
        "law": lambda p=places, g=ground, n=nobody: law_moves(
            p, coverage_aims(g, p, n).targets_m, n, Gains(0.5, 0.5), 1.0, 3.0
        )
    }
    centroids, middle = ground.cover(places).targets_m, np.full_like(places, 0.5 * side)
    for word, aims, more in (
        ("single integrators, spreading", centroids, {}),
        ("double integrators, spreading", centroids, inert),
        ("single integrators, to one place", middle, {}),
        ("double integrators, to one place", middle, inert),
    ):
        limits = MoveLimits(speed_m_s=3.0, body_radius_m=1.0, **more)
        jobs[word] = lambda p=places, g=ground, a=aims, m=limits: (
            plan_moves(g, Motion.at_rest(p), a, m, 0.5, 10).motion
        )
    for word, job in jobs.items():
        begun = process_time()
        job()
        times_s.setdefault(word, []).append(process_time() - begun)
times_figure, axes = plt.subplots(figsize=(7.0, 4.4), layout="constrained")
for word, times in times_s.items():
    axes.loglog(sizes, times, marker="o", label=word)
axes.set(title="computation per step", xlabel="agents [1]", ylabel="CPU time [s]")
axes.legend()
