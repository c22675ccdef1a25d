"""Tasks of planopt, and the results, checks and functions common to all tasks."""
