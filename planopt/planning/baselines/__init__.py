"""Planners to compare with, which look at most one step ahead."""
