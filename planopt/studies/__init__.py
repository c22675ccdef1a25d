"""Closed-loop comparisons over seeds."""
