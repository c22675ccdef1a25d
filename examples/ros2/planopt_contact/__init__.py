"""Node that plans with planopt."""
