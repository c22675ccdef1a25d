"""Judge the candidates of one step: worth by the objective, verdict by the verifier."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, connection_probability
from planopt.planning.certificate import Certificate, plan_message
from planopt.planning.leaving import leaving_path
from planopt.planning.plan import Plan, Rung, Termination, Verdict
from planopt.planning.proof.context import VerifierContext
from planopt.planning.proof.verify import verify
from planopt.planning.tolerances import margins_asked_db
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive
from planopt.world.clearance import ObstacleIndex


@dataclass(frozen=True)
class Candidate:
    """A path that may be released."""

    path_m: NDArray[np.float64]  # (N, 2)
    # What it is worth, in the sense of the problem, and the same of the lattice path of the same
    # step
    objective: float
    lattice_objective: float
    rung: Rung  # Where it comes from
    termination: Termination
    # What the verifier says; None and feasible_unverified before it was asked
    certificate: Certificate | None = None
    verdict: Verdict = Verdict.FEASIBLE_UNVERIFIED
    solve_s: float = 0.0  # Of the solver
    iterations: int = 0
    kkt_residual: float | None = None
    multipliers: dict[str, NDArray[np.float64]] = field(
        default_factory=dict[str, NDArray[np.float64]]
    )
    # Whether clearance, bounds, motion model and the distance from what moves are kept, whatever
    # connectivity is
    sound: bool = False
    # What the verifier predicted along the path, the robot's own place first
    power: Prediction | None = None
    # How the robot drives along the path; None for the single integrator
    drive: Drive | None = None

    @property
    def relaxes(self) -> bool:
        """Return whether some step misses the connectivity bound."""
        return self.certificate is not None and bool(self.certificate.relaxed_steps)

    @property
    def hopeless(self) -> bool:
        """Return whether the certificate shows that no path at all meets the bound at any step."""
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
        """Return by how much its steps miss the connectivity bound, in all."""
        return 0.0 if self.certificate is None else sum(self.certificate.relaxation_db)


@dataclass(frozen=True)
class Judge:
    """Everything a candidate of one step is judged by."""

    context: VerifierContext  # The problem, the belief, the robot's state and what moves
    objective: Callable[[NDArray[np.float64]], float]  # Value of a path (N, 2) from there
    # (N, 2) the rest of the last plan, which the other robots keep clear of; None without
    reserved_m: NDArray[np.float64] | None = None
    # Value of a drive, if it does not depend on its positions alone; else None
    objective_of_drive: Callable[[Drive], float] | None = None

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.context.problem

    @property
    def index(self) -> ObstacleIndex:
        """The obstacles."""
        return self.context.index

    @property
    def position_m(self) -> NDArray[np.float64]:
        """``(2,)`` where the robot is."""
        return self.context.position_m

    @property
    def state(self) -> NDArray[np.float64]:
        """``(s,)`` the robot's state, its position first."""
        return self.context.state

    def margins_db(self, power: Prediction) -> NDArray[np.float64]:
        """Connectivity margins of the step's problem."""
        return margins_asked_db(self.problem, power)

    def candidate(
        self,
        path_m: NDArray[np.float64],
        rung: Rung,
        termination: Termination,
        drive: Drive | None = None,
    ) -> Candidate:
        """Make a candidate of a path, not yet verified; `drive` says how it is driven."""
        # A solver may give back places that are no numbers.
        found = self.sense * -np.inf
        if np.isfinite(path_m).all():
            by_drive = None if drive is None else self.objective_of_drive
            found = self.objective(path_m) if by_drive is None or drive is None else by_drive(drive)
        return Candidate(path_m, found, found, rung, termination, drive=drive)

    @property
    def sense(self) -> float:
        """1 where more of the objective is better, -1 where less is: times this it is a worth."""
        return 1.0 if self.problem.sense == "max" else -1.0

    def worth(self, candidate: Candidate) -> float:
        """More is better, whatever the sense of the problem."""
        return self.sense * candidate.objective

    def judged(self, candidate: Candidate) -> Candidate:
        """Ask the verifier."""
        path = np.vstack([self.position_m, candidate.path_m])
        judgement = verify(self.context, path, candidate.kkt_residual, candidate.drive)
        return replace(
            candidate,
            certificate=judgement.certificate,
            verdict=judgement.verdict,
            sound=judgement.sound,
            power=judgement.power,
        )

    def standing(self, horizon: int) -> Candidate:
        """Stand still for N = `horizon` steps; if that is not sound go on as reserved, or leave.

        Every robot's plan keeps clear of what the others have reserved, so that this is the last
        resort that no other robot is in the way of. A robot that is where it must not be moves
        away (:func:`planopt.planning.leaving.leaving_path`).
        """
        place = np.tile(self.position_m, (horizon, 1))
        standing = self.judged(self.candidate(place, Rung.STOP, Termination.NO_PATH))
        if standing.sound:
            return standing
        rest = standing
        if self.reserved_m is not None and not np.array_equal(self.reserved_m, place):
            rest = self.judged(self.candidate(self.reserved_m, Rung.RESERVED, Termination.STOPPED))
            if rest.sound:
                return rest
        moving = self.context.moving
        path = leaving_path(self.problem, self.index, moving, self.position_m)
        if path is None:
            return rest
        return self.judged(self.candidate(path, Rung.LEAVE, Termination.NO_PATH))

    def plan_from(self, chosen: Candidate, wall_s: float) -> Plan:
        """Write a judged candidate out as a plan."""
        if chosen.certificate is None or chosen.power is None:
            raise AssertionError("only judged candidates are released")
        power = chosen.power
        positions = np.vstack([self.position_m, chosen.path_m])
        radio = self.problem.stations[0]
        return Plan(
            robot=self.problem.robots[0].name,
            t_s=self.problem.planner.step_s * np.arange(len(positions), dtype=np.float64),
            positions_m=positions,
            mean_dbm=power.mean_db,
            deviation_db=power.deviation_db,
            connectivity=connection_probability(
                power.mean_db, power.deviation_db, radio.threshold_dbm
            ),
            objective=chosen.objective,
            lattice_objective=chosen.lattice_objective,
            termination=chosen.termination,
            verdict=chosen.verdict,
            rung=chosen.rung,
            certificate=chosen.certificate,
            wall_s=wall_s,
            solve_s=chosen.solve_s,
            iterations=chosen.iterations,
            multipliers=chosen.multipliers,
            message=plan_message(chosen.certificate, positions),
            sense=self.problem.sense,
            drive=chosen.drive,
        )
