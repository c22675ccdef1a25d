"""Objects that move on a grid of motes."""

import numpy as np

from planopt.pursuit.records import Track


def walk(service, speed_m_s, steps, seed):
    """An object that turns at random, kept on the grid."""
    generator = np.random.default_rng(seed)
    step_s = 4.0 * service.frame_s
    turns = generator.normal(0.0, 0.3, steps).cumsum() + generator.uniform(0, 2 * np.pi)
    moves = speed_m_s * step_s * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    places = generator.uniform(0, service.side_m, 2) + np.vstack([[0, 0], moves.cumsum(axis=0)])
    # Folded back at the edges, which keeps the speed.
    places = np.abs(np.mod(places + service.side_m, 2 * service.side_m) - service.side_m)
    return Track(np.arange(steps + 1) * step_s, places)
