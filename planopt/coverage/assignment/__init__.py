"""How many agents respond to an event, and which."""
