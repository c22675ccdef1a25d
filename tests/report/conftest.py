"""A small world, belief, plan, run and comparison, real objects with chosen numbers."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from planopt import (
    BaseStation,
    ChannelSetup,
    Comparison,
    Constraints,
    Measurements,
    Obstacle,
    Plan,
    PlannerSettings,
    Problem,
    Robot,
    Run,
    Solution,
    Verdict,
    Workspace,
)
from planopt.channel import Belief, ChannelFit, ChannelParameters, Station, Truth, condition
from planopt.channel.kriging import connection_probability
from planopt.extend import Rung, Termination
from planopt.objectives import ReachObjective
from planopt.objectives.terms.term import Aim
from planopt.planning.certificate import Certificate
from planopt.planning.loop.log import Metrics, Outcome, RobotRun, StepLog
from planopt.planning.loop.results import RunSummary, summary_of
from planopt.studies.comparison import Row
from planopt.world import Raster

STATION = Station((50.0, 60.0), 5.0)
PARAMETERS = ChannelParameters(-30.0, 2.5, 4.0, 15.0, 1.5, STATION)
THRESHOLD_DBM = -72.0


@pytest.fixture(scope="session")
def problem() -> Problem:
    """100 m by 80 m, a block with a courtyard and a slanted one."""
    court = shapely.Polygon(
        [(40, 20), (60, 20), (60, 40), (40, 40)], [[(45, 25), (55, 25), (55, 35), (45, 35)]]
    )
    slanted = shapely.Polygon([(70, 50), (85, 55), (80, 70), (65, 65)])
    return Problem(
        name="small",
        description="",
        workspace=Workspace(
            (0.0, 0.0, 100.0, 80.0), (Obstacle("a", court), Obstacle("b", slanted))
        ),
        channel=ChannelSetup(),
        robots=(Robot(name="rover", start_m=(10.0, 10.0), goal_m=(90.0, 75.0), speed_max_m_s=1.0),),
        stations=(
            BaseStation(
                name="mast",
                position_m=STATION.position_m,
                height_m=STATION.height_m,
                transmit_power_dbm=20.0,
                threshold_dbm=THRESHOLD_DBM,
            ),
        ),
        objective=ReachObjective(0.1, "connected"),
        constraints=Constraints(p_min=0.8, clearance_m=1.5),
        planner=PlannerSettings(horizon=4, step_s=2.0, neighbours=32, max_steps=100),
    )


@pytest.fixture(scope="session")
def measurements() -> Measurements:
    generator = np.random.default_rng(3)
    power = generator.normal(-70.0, 6.0, 30)
    return Measurements(generator.uniform(0.0, 80.0, (30, 2)), power, np.arange(30) >= 25)


@pytest.fixture(scope="session")
def fit() -> ChannelFit:
    return ChannelFit(
        method="reml",
        status="ok",
        parameters=PARAMETERS,
        standard_errors={
            "k_pl_db": 1.0,
            "n_pl": 0.1,
            "shadow_std_db": 0.5,
            "decorrelation_m": 3.0,
            "multipath_std_db": float("inf"),
        },
        theta_covariance=np.eye(2),
        measurements=30,
        censored=5,
        warnings=(),
        log_likelihood=None,
    )


@pytest.fixture(scope="session")
def belief(fit: ChannelFit, measurements: Measurements) -> Belief:
    return Belief(fit, condition(PARAMETERS, measurements))


@pytest.fixture(scope="session")
def plan(belief: Belief) -> Plan:
    """Four steps, the third of which misses the bound."""
    positions = np.array([[10.0, 10.0], [12.0, 10.5], [13.5, 11.5], [15.0, 12.0], [16.0, 13.0]])
    prediction = belief.posterior.predict(positions)
    return Plan(
        robot="rover",
        t_s=2.0 * np.arange(5),
        positions_m=positions,
        mean_dbm=prediction.mean_db,
        deviation_db=prediction.deviation_db,
        connectivity=connection_probability(
            prediction.mean_db, prediction.deviation_db, THRESHOLD_DBM
        ),
        objective=101.25,
        lattice_objective=103.5,
        termination=Termination.CONVERGED,
        verdict=Verdict.VERIFIED,
        rung=Rung.PLAN,
        certificate=Certificate(
            min_clearance_m=1.625,
            min_connectivity=0.8125,
            dynamics_defect=2.5e-9,
            kkt_residual=3.5e-7,
            posterior="exact",
            relaxed_steps=(3,),
            relaxation_db=(0.75,),
            best_margin_db=(-0.75,),
        ),
        wall_s=0.042,
        solve_s=0.03,
        iterations=17,
    )


@pytest.fixture(scope="session")
def solution(problem: Problem, belief: Belief, plan: Plan) -> Solution:
    return Solution(problem, 0, belief, (plan,), (Aim(),))


@pytest.fixture(scope="session")
def log() -> StepLog:
    """Six steps by different rungs, one out of contact, one relaxed."""
    count = 7
    return StepLog(
        t_s=2.0 * np.arange(count),
        positions_m=np.stack([10.0 + 2.0 * np.arange(count), 10.0 + np.arange(count)], axis=1),
        predicted_dbm=-70.0 + np.arange(count),
        deviation_db=np.full(count, 5.0),
        connectivity=np.linspace(0.75, 0.95, count),
        true_dbm=-71.0 + 0.5 * np.arange(count),
        connected=np.array([1, 1, 0, 1, 1, 1, 1], dtype=bool),
        step_s=np.array([0.0, 0.02, 0.03, 0.01, 0.04, 0.05, 0.02]),
        polish_gain_s=np.zeros(count),
        relaxation_db=np.array([0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0]),
        rung=(*[Rung.PLAN] * 3, Rung.RELAXED, Rung.SHIFTED, Rung.PLAN, Rung.PLAN),
        verdict=(Verdict.VERIFIED,) * count,
    )


@pytest.fixture(scope="session")
def simulation(problem: Problem, belief: Belief, plan: Plan, log: StepLog) -> Run:
    metrics = Metrics(12.0, 13.4, 5 / 6, 2.2, 0.78, 0.01, 5)
    run = RobotRun("rover", Outcome.STEP_LIMIT, "six steps", log, metrics)
    x, y = np.arange(0.5, 100.0), np.arange(0.5, 80.0)
    values = -90.0 + 0.3 * x[None, :] + 0.1 * y[:, None]
    truth = Truth(Raster(x, y, values), -100.0, values)
    return Run(problem, 5, (truth,), (run,), ((plan,),), ((Aim(),),), (belief,), 24)


@pytest.fixture(scope="session")
def comparison(problem: Problem, simulation: Run) -> Comparison:
    """Two horizons under two costs to go and two planners, two runs each; one never arrives."""
    runs: list[RunSummary] = []
    rows: list[Row] = []
    for cost, planner in (("geodesic", "auto"), ("connected", "lattice")):
        for horizon in (10, 1):
            lost = (cost, horizon) == ("geodesic", 1)
            for seed in (0, 1):
                time_s = float("nan") if lost else 50.0 + horizon + seed
                share, gain = 0.88 + 0.04 * seed, 0.0123 * seed
                metrics = Metrics(time_s, 70.0, share, 4.0 * seed, 0.81, gain, 5)
                outcome = Outcome.STALLED if lost else Outcome.REACHED
                run = replace(simulation.run, outcome=outcome, reason="", metrics=metrics)
                summary = summary_of(replace(simulation, runs=(run,), seed=seed))
                runs.append(replace(summary, horizon=horizon, planner=planner, cost_to_go=cost))
            shared = {"verified_rate": 0.875, "p50_step_s": 0.0125, "p95_step_s": 0.04}
            shared["problem"] = problem.name
            setting = (horizon, planner, cost, 2, 2 if lost else 0)
            mean = None if lost else 50.5 + horizon
            rows += [
                Row(*setting, "goal_time_s", mean, mean and mean - 6.353, mean and mean + 6.353,
                    0 if lost else 2, None, **shared),
                Row(*setting, "true_connected_share", 0.9, None, None, 2, None, **shared),
                Row(*setting, "longest_outage_m", 2.0, 1.0, 3.0, 2, None, **shared),
                Row(*setting, "polish_gain", 0.0123, 0.0, 0.02, 2, None, **shared),
            ]  # fmt: skip
    return Comparison(problem, tuple(runs), tuple(rows), 3.25)
