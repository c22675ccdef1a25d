"""Global search: where a refinement starts from."""
