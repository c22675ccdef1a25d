"""How plans are sought that keep a rule of connectivity, one file for each kind of rule."""
