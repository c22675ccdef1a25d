"""What a path is worth by all terms of the objective."""
