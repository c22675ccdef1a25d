"""What must change nothing: a redundant obstacle, another unit of length; and what must order."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import affinity
from terms_scene import ENERGY, LEARNING, TRACKING, context_of, scorer_of, terms_problem

from planopt import Measurements, Obstacle, Plan, Problem, Verdict, Workspace
from planopt.channel import condition
from planopt.objectives import MotionEnergyTerm, TrackingTerm
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.programme import path_nlp
from planopt.planning.proof.rule import VerifierContext
from planopt.planning.values.context import Aim, StepContext, step_context, workspace_region
from planopt.world import index_obstacles

pytestmark = pytest.mark.usefixtures("converged")

TERMS = [(TRACKING,), (LEARNING,), (TRACKING, LEARNING, ENERGY)]


@pytest.fixture
def converged(monkeypatch):
    """Polishes that go on to the optimum: those that have settled end where they happen to be."""
    monkeypatch.setattr(path_nlp, "SETTLED", {})


def planned(situation: StepContext, belief, problem: Problem | None = None) -> Plan:
    """The plan of a situation, in the problem or in another."""
    if problem is not None:
        situation = replace(situation, problem=problem)
    scorer, ground = scorer_of(situation, belief)
    return HorizonPlanner(situation.problem, ground).plan(situation, scorer)


@pytest.mark.parametrize("terms", TERMS)
def test_redundant_obstacles_change_nothing(terms):
    """One inside another, one out of reach, and one beyond the border."""
    problem = terms_problem(*terms, p_min=0.6)
    situation, belief = context_of(problem)
    more = (
        Obstacle("inside", shapely.box(19.0, 14.0, 21.0, 20.0)),
        Obstacle("far", shapely.box(36.0, 34.0, 39.0, 38.0)),
        Obstacle("beyond", shapely.box(60.0, 60.0, 70.0, 70.0)),
    )
    walls = replace(
        problem,
        workspace=replace(problem.workspace, obstacles=(*problem.workspace.obstacles, *more)),
    )
    plain, walled = planned(situation, belief), planned(situation, belief, walls)
    assert (plain.verdict, plain.rung) == (walled.verdict, walled.rung)
    # The solver's tolerance is 1e-4 where a worth counts 10.
    assert walled.objective == pytest.approx(plain.objective, rel=1e-5)
    # IPOPT ends elsewhere on a plateau when a line stands twice.
    np.testing.assert_allclose(walled.positions_m, plain.positions_m, atol=1e-2)


def scaled_problem(problem: Problem, by: float) -> Problem:
    """The same scene in a unit of length of which `by` make the old one."""

    def place(at: tuple[float, float]) -> tuple[float, float]:
        return (by * at[0], by * at[1])

    obstacles = tuple(
        Obstacle(o.name, affinity.scale(o.polygon, by, by, origin=(0.0, 0.0)))
        for o in problem.workspace.obstacles
    )
    bounds = tuple(by * value for value in problem.workspace.bounds_m)
    terms = []
    for term in problem.terms:
        if isinstance(term, TrackingTerm):
            term = replace(
                term,
                noise_curvature=term.noise_curvature / by**2,
                sweet_spot_m=by * term.sweet_spot_m,
            )
        if isinstance(term, MotionEnergyTerm):
            term = replace(term, per_metre_j_m=term.per_metre_j_m / by)
        terms.append(term)
    robot, station = problem.robots[0], problem.stations[0]
    return replace(
        problem,
        workspace=Workspace(bounds, obstacles),
        robots=(
            replace(robot, start_m=place(robot.start_m), speed_max_m_s=by * robot.speed_max_m_s),
        ),
        stations=(
            replace(station, position_m=place(station.position_m), height_m=by * station.height_m),
        ),
        objective=replace(problem.objective, terms=tuple(terms)),
        constraints=replace(problem.constraints, clearance_m=by * problem.constraints.clearance_m),
        channel=replace(problem.channel, measure_spacing_m=by * problem.channel.measure_spacing_m),
    )


@pytest.mark.parametrize("by", [0.1, 100.0])
@pytest.mark.parametrize("terms", TERMS)
def test_another_unit_of_length_changes_nothing(terms, by):
    """Lengths, speeds, decorrelation and what goes by the metre scaled: the same plan, scaled.

    But for the planner's pads, which are lengths: a millimetre of clearance, a micrometre of step.
    """
    problem = terms_problem(*terms, p_min=0.6)
    situation, belief = context_of(problem)
    plain = planned(situation, belief)
    other = scaled_problem(problem, by)
    known = situation.posterior.measurements
    parameters = situation.posterior.parameters
    posterior = condition(
        replace(
            parameters,
            k_pl_db=parameters.k_pl_db + 10.0 * parameters.n_pl * np.log10(by),
            decorrelation_m=by * parameters.decorrelation_m,
            station=other.stations[0].site,
        ),
        Measurements(by * known.positions_m, known.power_dbm, known.censored),
    )
    target = None if situation.aim.target_m is None else by * situation.aim.target_m
    here = by * situation.position_m
    index = index_obstacles(other.workspace)
    base = VerifierContext(other, index, (posterior,), here)
    stretched = step_context(base, workspace_region(other), Aim(target))
    plan = planned(stretched, replace(belief, posterior=posterior))
    assert plan.verdict is plain.verdict is Verdict.VERIFIED
    assert plan.objective == pytest.approx(plain.objective, rel=2e-3)
    np.testing.assert_allclose(plan.positions_m / by, plain.positions_m, atol=0.1)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("terms", TERMS)
def test_what_has_settled_is_all_but_the_optimum(terms, seed, monkeypatch):
    """Stopping a polish early costs a thousandth of the worth at most."""
    problem = terms_problem(*terms, p_min=0.6)
    situation, belief = context_of(problem, seed)
    optimum = planned(situation, belief)
    monkeypatch.undo()
    settled = planned(replace(situation), belief)
    assert settled.verdict is optimum.verdict
    assert settled.objective >= optimum.objective * (1.0 - 1e-3)
