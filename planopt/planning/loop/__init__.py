"""Closed loop: motion, measurement, belief update and logging."""
