"""Tolerances of planning, with their reasons."""

CLEARANCE_TOLERANCE_M = 1e-6
"""Verifier's tolerance of distances: round-off at coordinates of some hundred metres."""
DYNAMICS_TOLERANCE_M = 1e-5
"""Verifier's tolerance of the dynamics: about the accuracy of IPOPT on steps of metres."""
MARGIN_TOLERANCE_DB = 1e-6
"""Verifier's tolerance of margins: round-off of the exact posterior, 1e-7 in probability."""
CLEARANCE_PAD_M = 1e-3
"""Clearance that planners add, so that the solver's tolerance causes no violation."""
STEP_PAD_M = 1e-6
"""Length by which planners shorten steps, so that the solver's tolerance causes no violation."""
MARGIN_PAD_DB = 0.02
"""Connectivity margin that planners add, so that the solver's tolerance causes no violation."""
STANDSTILL_M = 1e-3  # Minimum length of a step that counts as motion
RULE_TOLERANCE = 1e-7
"""Verifier's tolerance: :data:`MARGIN_TOLERANCE_DB` as a probability, or relative to a bound."""
