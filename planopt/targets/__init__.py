"""Target tracking: motion model, sensor model and information filter of the station."""
