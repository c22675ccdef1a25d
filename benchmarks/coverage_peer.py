"""Compare the coverage laws with CoverageControl on one scene: time per step, steps, final cost.

``python benchmarks/coverage_peer.py --peer ENVIRONMENT/lib/python3.11/site-packages`` needs an
environment with CoverageControl 1.3.1. Only its compiled core is imported, so PyTorch is not
needed. Both start with the same 30 agents under three Gaussian peaks; planopt evaluates the costs.
"""

import argparse
import importlib
import sys
import time
import types
from pathlib import Path

import numpy as np

import planopt
from planopt.problems import problem_from_dict

SIDE_M, SPEED_M_S = 400.0, 5.0
PEAKS = (((100.0, 300.0), 30.0, 1.0), ((300.0, 120.0), 40.0, 1.0), ((320.0, 320.0), 20.0, 0.6))
TRUNCATION = 8.0
"""Radius of the peer's peaks in standard deviations; planopt does not truncate."""


def ours(starts, planner):
    """Return planopt's final positions, CPU times of the steps, and the ground."""
    bumps = [{"weight": w, "mean_m": list(mean), "std_m": std} for mean, std, w in PEAKS]
    tables = {
        "problem": {"schema": 1, "name": "peer", "task": "coverage"},
        "world": {"bounds_m": [0, 0, SIDE_M, SIDE_M]},
        "density": {"kind": "gaussians", "bumps": bumps},
        "agents": {
            "start": {"kind": "list", "places_m": starts.tolist()},
            "speed_max_m_s": SPEED_M_S,
        },
        "control": {"time_step_s": 1.0, "duration_s": 400, "coverage_gain_per_s": 1.0},
    }
    network, times_s = planopt.Planner(problem_from_dict(tables), planner=planner), []
    for _ in range(400):
        begun = time.process_time()
        action = network.step()
        times_s.append(time.process_time() - begun)
        if action.settled:
            break
    return action.motion.places_m, times_s, network.scene.ground


def peers(starts, site_packages):
    """Return the final positions of the peer's clairvoyant law, and CPU times of its law."""
    package = types.ModuleType("coverage_control")
    package.__path__ = [str(site_packages / "coverage_control")]
    sys.modules["coverage_control"] = package
    core = importlib.import_module("coverage_control._core")
    settings = core.Parameters()
    settings.pNumRobots, settings.pMaxRobotSpeed = len(starts), SPEED_M_S
    settings.pWorldMapSize = settings.pRobotMapSize = int(SIDE_M)
    settings.pTruncationBND = TRUNCATION
    world = core.WorldIDF(settings)
    for mean, std, weight in PEAKS:
        peak = core.BivariateNormalDistribution(np.array(mean), std, weight)
        world.AddNormalDistribution(peak)
    world.GenerateMapCPU()
    system = core.CoverageSystem(settings, world, core.PointVector(list(starts)))
    law, times_s = core.ClairvoyantCVT(settings, len(starts), system), []
    for _ in range(1000):
        begun = time.process_time()
        law.ComputeActions()
        times_s.append(time.process_time() - begun)
        if law.IsConverged():
            break
        system.StepActions(law.GetActions())
    return np.array(system.GetRobotPositions()), times_s


def main() -> None:
    """Print median times, numbers of steps and final costs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peer", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=10)
    given = parser.parse_args()
    for seed in range(given.seeds):
        starts = np.random.default_rng(seed).uniform(20.0, 180.0, (30, 2))
        runs = {planner: ours(starts, planner) for planner in ("law", "deploy")}
        ground = runs["law"][2]
        runs["CoverageControl"] = peers(starts, given.peer)
        for name, (places_m, times_s, *_) in runs.items():
            print(
                f"seed {seed}, {name}: {1e3 * np.median(times_s):.1f} ms, {len(times_s)} steps, "
                f"cost {ground.cover(places_m).cost:.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
