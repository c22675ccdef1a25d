"""The task pursuit_design: slot width, rate and compression of a network that serves a pursuit."""
