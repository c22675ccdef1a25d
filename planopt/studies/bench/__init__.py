"""The solver regression suite: every library problem against committed references."""
