"""Global searches for the initial guesses of the refinement."""
