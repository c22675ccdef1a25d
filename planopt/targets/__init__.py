"""Targets: how one moves, how it is sensed, and what the station knows of it."""
