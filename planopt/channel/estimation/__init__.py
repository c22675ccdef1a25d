"""Fits of the channel to measurements by five methods, with their uncertainty."""
