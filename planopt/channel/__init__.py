"""How received power varies in space."""
