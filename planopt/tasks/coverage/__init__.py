"""The task coverage: a network of agents that covers a region and answers events."""
