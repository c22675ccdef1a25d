"""Fields of shadowing to draw, and the truth that only the simulator touches."""
