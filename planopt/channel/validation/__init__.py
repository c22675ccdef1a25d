"""How far a fitted channel can be believed: held-out walks and calibration."""
