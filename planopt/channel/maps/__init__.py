"""The posterior over many places at once."""
