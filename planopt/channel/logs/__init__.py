"""Power logs as files."""
