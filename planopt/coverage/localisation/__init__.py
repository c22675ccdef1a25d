"""Localisation of an event from the strength of its signal at the agents."""
