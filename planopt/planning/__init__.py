"""Planning: plans are found, refined and verified."""
