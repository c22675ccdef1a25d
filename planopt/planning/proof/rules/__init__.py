"""The rules of connectivity, one class in each file."""
