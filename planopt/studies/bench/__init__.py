"""Regression suite of the solvers: every library problem against committed references."""
