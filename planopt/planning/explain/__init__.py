"""Explanations of missing verified plans in terms of problem file keys, with helpful changes."""
