"""The rules of connectivity, one judged in each file."""
