"""Task coverage: a network of agents covers a region and responds to events."""
