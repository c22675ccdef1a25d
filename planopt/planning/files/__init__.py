"""Files of plans and runs."""
