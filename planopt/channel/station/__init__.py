"""Where an unknown station is."""
