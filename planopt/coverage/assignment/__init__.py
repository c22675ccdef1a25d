"""The agents that respond to an event: how many, and which."""
