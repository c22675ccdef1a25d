"""Pursuit over distance-sensitive snapshots: the service, its guarantees, its design, the chase."""
