"""The workspace and its obstacles."""
