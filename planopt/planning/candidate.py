"""A path that may be released, and what is known of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction
from planopt.planning.certificate import Certificate
from planopt.planning.plan import Rung, Termination, Verdict
from planopt.robots.drive import Drive


@dataclass(frozen=True)
class Candidate:
    """A path that may be released.

    Attributes
    ----------
    path_m
        ``(N, 2)``.
    objective, lattice_objective
        What it is worth, in the sense of the problem, and the same of the lattice path of the
        same step.
    rung, termination
        Where it comes from.
    certificate, verdict
        What the verifier says; None and ``feasible_unverified`` before it was asked.
    solve_s, iterations, multipliers, kkt_residual
        Of the solver.
    sound
        Whether clearance, bounds, motion model and the distance from what moves are kept, whatever
        connectivity is.
    power
        What the verifier predicted along the path, the robot's own place first.
    drive
        How the robot drives along the path; None for the single integrator.
    """

    path_m: NDArray[np.float64]
    objective: float
    lattice_objective: float
    rung: Rung
    termination: Termination
    certificate: Certificate | None = None
    verdict: Verdict = Verdict.FEASIBLE_UNVERIFIED
    solve_s: float = 0.0
    iterations: int = 0
    kkt_residual: float | None = None
    multipliers: dict[str, NDArray[np.float64]] = field(
        default_factory=dict[str, NDArray[np.float64]]
    )
    sound: bool = False
    power: Prediction | None = None
    drive: Drive | None = None

    @property
    def relaxes(self) -> bool:
        """Whether some step misses the connectivity bound."""
        return self.certificate is not None and bool(self.certificate.relaxed_steps)

    @property
    def hopeless(self) -> bool:
        """Whether the certificate shows that no path at all meets the bound at any step."""
        if self.certificate is None or len(self.certificate.relaxed_steps) < len(self.path_m):
            return False
        # Where slack is bounded, no search shows anything.
        return max(self.certificate.best_margin_db, default=0.0) < 0.0

    @property
    def avoidable(self) -> tuple[int, ...]:
        """Steps that miss the bound although a place that meets it is said to be within reach."""
        if self.certificate is None:
            return ()
        # Without a search for places there are none.
        named = zip(self.certificate.relaxed_steps, self.certificate.best_margin_db, strict=False)
        return tuple(step for step, margin in named if margin >= 0.0)

    @property
    def missing_db(self) -> float:
        """By how much its steps miss the connectivity bound, in all."""
        return 0.0 if self.certificate is None else sum(self.certificate.relaxation_db)


def with_effort(chosen: Candidate, tried: list[Candidate]) -> Candidate:
    """Count the solver's time and iterations even where its points were not used.

    It stopped for what its last solve of the step stopped for.
    """
    polished = [c for c in tried if c.termination is not Termination.LATTICE_ONLY]
    return replace(
        chosen,
        solve_s=sum(c.solve_s for c in polished),
        iterations=sum(c.iterations for c in polished),
        termination=polished[-1].termination if polished else chosen.termination,
    )
