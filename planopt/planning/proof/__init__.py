"""What is proven of a path, from the problem and the belief alone."""
