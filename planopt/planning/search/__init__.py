"""Global search: where a polish starts from."""
