"""The posterior from the nearest measurements, at a cost that does not grow with all."""
