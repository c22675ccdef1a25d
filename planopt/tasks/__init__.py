"""Tasks of planopt (motion, coverage, pursuit, design), with their common results and checks."""
