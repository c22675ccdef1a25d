"""Every tolerance of planning in one place, each with its reason. Solver settings are elsewhere."""

from __future__ import annotations

CLEARANCE_TOLERANCE_M = 1e-6
"""The verifier's: round-off of exact distances at coordinates of some hundred metres."""

DYNAMICS_TOLERANCE_M = 1e-5
"""The verifier's: IPOPT keeps a step of metres to about this; a hundredth of a millimetre."""

MARGIN_TOLERANCE_DB = 1e-6
"""The verifier's: round-off of an exact posterior; 1e-6 dB moves a probability by 1e-7."""

CLEARANCE_PAD_M = 1e-3
"""Planners keep this much more than asked, so that solver tolerance never eats the clearance."""

STEP_PAD_M = 1e-6
"""Planners plan steps this much shorter, for the same reason."""

MARGIN_PAD_DB = 0.02
"""Planners plan for this much more connectivity margin than asked, for the same reason."""

STANDSTILL_M = 1e-3
"""A step shorter than this does not count as moving."""

RULE_TOLERANCE = 1e-7
"""The verifier's: what :data:`MARGIN_TOLERANCE_DB` is in probability, as a share of what is asked
where that is more than one."""
