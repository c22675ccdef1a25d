"""Control of agents that cover a region and respond to events."""
