"""Workspace, obstacles, lattice and distance computations."""
