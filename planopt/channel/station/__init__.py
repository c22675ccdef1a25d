"""The position of an unknown station."""
