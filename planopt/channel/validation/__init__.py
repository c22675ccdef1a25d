"""Validation of a fitted channel: held-out walks and calibration."""
