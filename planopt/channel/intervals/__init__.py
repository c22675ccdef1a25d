"""Powers known to lie in an interval, as Gaussian ones."""
