"""Objective value of a path as a sum of terms, and the step context."""
