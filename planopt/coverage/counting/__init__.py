"""How many agents there are, found by the agents themselves over their links."""
