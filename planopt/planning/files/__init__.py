"""Plans and runs as files."""
