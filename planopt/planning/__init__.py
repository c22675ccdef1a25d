"""Planning: initial guesses, refinement, verification and fallbacks."""
