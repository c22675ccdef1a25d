"""The same step in do-mpc: full kriging written out, discs about the polygons, the same IPOPT.

Only where do-mpc is installed (the ``bench`` extra). It starts where the robot stands, as its users
would; there is no search, no certificate and no belief update in its time.
"""

from __future__ import annotations

import warnings
from time import perf_counter, process_time
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import whiten
from planopt.channel.kriging import bound_quantile
from planopt.channel.parameters import regressors
from planopt.objectives.stage_power import CUSP_ROUNDING
from planopt.planning.programme.solver import OPTIONS
from planopt.planning.values.context import StepContext


class DoMpcStep:
    """A built controller for one situation; `step` solves.

    Parameters
    ----------
    situation
        Of a tracking problem.
    symbols
        ``SX``, do-mpc's own choice, or ``MX``, which keeps products of matrices whole.
    """

    def __init__(self, situation: StepContext, symbols: str = "SX") -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import do_mpc
        problem, target = situation.problem, situation.aim.target_m
        if target is None:
            raise AssertionError("tracking has a target")
        model = do_mpc.model.Model("discrete", symbols)
        at = model.set_variable("_x", "at", (2, 1))
        move = model.set_variable("_u", "move", (2, 1))
        model.set_variable("_tvp", "evader", (2, 1))
        model.set_rhs("at", at + move)
        model.setup()
        # Expressions for the controller must be of the symbols that the model made in setup.
        move, evader = model.u["move"], model.tvp["evader"]
        following = model.x["at"] + move
        mean, deviation = _power(situation, following)
        radio = problem.stations[0]
        settings = problem.terms[0].settings(situation)
        chance = 0.5 * (1.0 + ca.erf((mean - radio.threshold_dbm) / deviation / np.sqrt(2.0)))
        from_sweet = ca.sqrt(ca.sumsqr(following - evader) + 1e-6) - settings.sensor.sweet_spot_m
        noise = settings.sensor.growth * from_sweet**2 + settings.sensor.least_noise_m2

        self._mpc: Any = do_mpc.controller.MPC(model)
        self._mpc.settings.n_horizon = problem.planner.horizon
        self._mpc.settings.t_step = problem.planner.step_s
        self._mpc.settings.store_full_solution = False
        self._mpc.settings.nlpsol_opts = {
            key: value for key, value in OPTIONS.items() if key.startswith("ipopt.")
        } | {"print_time": False}
        self._mpc.set_objective(mterm=0.0 * model.x["at"][0], lterm=-chance / noise)
        self._mpc.set_rterm(move=0.0)
        x_min, y_min, x_max, y_max = problem.workspace.bounds_m
        self._mpc.bounds["lower", "_x", "at"] = np.array([x_min, y_min])
        self._mpc.bounds["upper", "_x", "at"] = np.array([x_max, y_max])
        self._mpc.set_nl_cons("speed", ca.sumsqr(move), ub=problem.step_length_m**2)
        if problem.constraints.p_min > 0.0:
            z = bound_quantile(problem.constraints.p_min)
            self._mpc.set_nl_cons("bound", z * deviation + radio.threshold_dbm - mean, ub=0.0)
        for number, obstacle in enumerate(problem.workspace.obstacles):
            corners = np.asarray(obstacle.polygon.exterior.coords)[:-1]
            centre = corners.mean(axis=0)
            radius = np.linalg.norm(corners - centre, axis=1).max()
            self._mpc.set_nl_cons(
                f"disc{number}", radius**2 - ca.sumsqr(following - centre), ub=0.0
            )
        given = self._mpc.get_tvp_template()

        def expected(_time: float) -> Any:
            for k in range(problem.planner.horizon + 1):
                given["_tvp", k, "evader"] = target[min(k, len(target) - 1)]
            return given

        self._mpc.set_tvp_fun(expected)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._mpc.setup()
        self._start = situation.position_m

    def step(self) -> tuple[float, float, NDArray[np.float64]]:
        """Solve from standing still: wall seconds, CPU seconds, the path (N, 2)."""
        self._mpc.x0 = self._start
        self._mpc.u0 = np.zeros(2)
        self._mpc.set_initial_guess()
        wall, cpu = perf_counter(), process_time()
        self._mpc.make_step(self._start)
        wall, cpu = perf_counter() - wall, process_time() - cpu
        stages = self._mpc.opt_x_num["_x", :, 0, 0]
        return wall, cpu, np.array([np.asarray(place).ravel() for place in stages])[1:]

    @property
    def status(self) -> str:
        """What IPOPT says of the last solve."""
        return str(self._mpc.solver_stats["return_status"])

    @property
    def iterations(self) -> int:
        """Its iterations."""
        return int(self._mpc.solver_stats["iter_count"])


def _power(situation: StepContext, place: Any) -> tuple[Any, Any]:
    """Mean and deviation at a place, by universal kriging from all measurements."""
    posterior = situation.posterior
    parameters = posterior.parameters
    station = parameters.station
    inverse = whiten(posterior.factor, np.eye(len(posterior.measurements)))
    precision = inverse.T @ inverse
    gamma_m = regressors(posterior.measurements.positions_m, station)
    trend = precision @ gamma_m
    weights = precision @ posterior.values_db - trend @ posterior.theta
    offset = ca.DM(posterior.measurements.positions_m.T) - ca.repmat(place, 1, len(weights))
    rounding = CUSP_ROUNDING * parameters.decorrelation_m
    distance = ca.sqrt(ca.sum1(offset**2).T + rounding**2)
    phi = parameters.shadow_std_db**2 * ca.exp(-distance / parameters.decorrelation_m)
    square = ca.sumsqr(place - np.asarray(station.position_m)) + station.height_m**2
    gamma = ca.vertcat(1.0, -5.0 * ca.log10(square + 0.01))
    mean = ca.dot(gamma, posterior.theta) + ca.dot(weights, phi)
    b = gamma - ca.mtimes(trend.T, phi)
    variance = parameters.shadow_std_db**2 + parameters.multipath_std_db**2
    variance -= ca.dot(phi, ca.mtimes(precision, phi))
    variance += ca.dot(b, ca.mtimes(posterior.theta_covariance, b))
    return mean, ca.sqrt(variance)
