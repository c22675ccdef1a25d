"""The dynamics of robots."""
