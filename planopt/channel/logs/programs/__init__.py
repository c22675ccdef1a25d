"""Declarations of the logs that known programs write, one module each."""
