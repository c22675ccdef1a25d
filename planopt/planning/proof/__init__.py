"""Verification of a path, from the problem and the belief alone."""
