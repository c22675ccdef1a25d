"""Fits of the channel to measurements: five methods, their likelihoods and uncertainty."""
