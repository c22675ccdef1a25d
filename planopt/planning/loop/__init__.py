"""The closed loop: move, measure, learn, and the log of it."""
