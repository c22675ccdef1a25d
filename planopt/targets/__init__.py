"""What is tracked: how a target moves, how it is sensed, and what the station knows of it."""
