"""A candidate path and its judge: worth by the objective, verdict by the verifier."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.connectivity import bound_margin_db, connection_probability
from planopt.channel.prediction import Prediction
from planopt.planning.history import BEGINNING, History
from planopt.planning.message import plan_message
from planopt.planning.plan import Certificate, Plan, Rung, Termination, Verdict
from planopt.planning.proof.broad_prediction import BroadPrediction
from planopt.planning.proof.verify import judge
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive
from planopt.world.clearance import ObstacleIndex
from planopt.world.moving_discs import NOTHING_MOVES, MovingDiscs


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
        return max(self.certificate.best_margin_db) < 0.0

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


@dataclass(frozen=True)
class Judge:
    """Everything a candidate of one step is judged by.

    Attributes
    ----------
    problem, index, belief
        The problem, its obstacles, and what is believed of the channel.
    position_m
        ``(2,)`` where the robot is.
    objective
        What a path (N, 2) from there is worth.
    moving
        What moves during the steps.
    reserved_m
        ``(N, 2)`` the rest of the last plan, which the other robots keep clear of; None without.
    history
        What has happened on the run before.
    broad
        What the bound rests on where all parameters are to count as uncertain.
    rest
        What the robot's state has beyond its place; nothing of a single integrator.
    """

    problem: Problem
    index: ObstacleIndex
    belief: Belief
    position_m: NDArray[np.float64]
    objective: Callable[[NDArray[np.float64]], float]
    moving: MovingDiscs = NOTHING_MOVES
    reserved_m: NDArray[np.float64] | None = None
    history: History = BEGINNING
    broad: BroadPrediction | None = None
    rest: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    @property
    def state(self) -> NDArray[np.float64]:
        """``(s,)`` the robot's state, its place first."""
        return np.concatenate([self.position_m, self.rest])

    def margins_db(self, power: Prediction) -> NDArray[np.float64]:
        """Connectivity margins of the step's problem."""
        return bound_margin_db(
            power.mean_db,
            power.deviation_db,
            self.problem.stations[0].threshold_dbm,
            self.problem.constraints.p_min,
        )

    def candidate(
        self,
        path_m: NDArray[np.float64],
        rung: Rung,
        termination: Termination,
        drive: Drive | None = None,
    ) -> Candidate:
        """Make a candidate of a path, not yet verified; `drive` says how it is driven."""
        # A solver may give back places that are no numbers.
        nothing = np.inf if self.problem.sense == "min" else -np.inf
        worth = self.objective(path_m) if np.isfinite(path_m).all() else nothing
        return Candidate(path_m, worth, worth, rung, termination, drive=drive)

    def judged(self, candidate: Candidate) -> Candidate:
        """Ask the verifier."""
        path = np.vstack([self.position_m, candidate.path_m])
        judgement = judge(
            self.problem,
            self.index,
            self.belief.posterior,
            self.state,
            path,
            candidate.kkt_residual,
            self.moving,
            self.history,
            self.broad,
            candidate.drive,
        )
        return replace(
            candidate,
            certificate=judgement.certificate,
            verdict=judgement.verdict,
            sound=judgement.sound,
            power=judgement.power,
        )

    def standing(self, horizon: int) -> Candidate:
        """Stand still for N = `horizon` steps, or go on as reserved where that is not sound.

        Every robot's plan keeps clear of what the others have reserved, so that this is the last
        resort that no other robot is in the way of.
        """
        place = np.tile(self.position_m, (horizon, 1))
        standing = self.judged(self.candidate(place, Rung.STOP, Termination.NO_PATH))
        if standing.sound or self.reserved_m is None:
            return standing
        return self.judged(self.candidate(self.reserved_m, Rung.RESERVED, Termination.STOPPED))

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
