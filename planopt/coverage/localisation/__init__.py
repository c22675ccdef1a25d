"""Where an event is, from the strength of its signal at the agents."""
