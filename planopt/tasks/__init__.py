"""The tasks of planopt, and what all tasks share: results, checks and calls."""
