"""The planners' halves of the rules of connectivity, one file for each kind of rule."""
