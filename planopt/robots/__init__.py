"""Robot dynamics: models, interface and CasADi maps."""
