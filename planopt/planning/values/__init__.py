"""The objective value of a path, by all terms."""
