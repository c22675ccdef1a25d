"""planopt: motion plans for robots that must stay in radio contact."""
