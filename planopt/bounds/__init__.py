"""Certified bounds: how far from the optimum a plan can be."""
