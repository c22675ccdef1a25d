"""Solve, simulate, print and draw networks that cover a region and answer events."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np

from planopt.coverage.optima import best_deployment
from planopt.coverage.simulation import simulate_network
from planopt.files.tables import write_tables
from planopt.problems.systems import (
    Answer,
    Request,
    System,
    SystemProblem,
    asked_planners,
)
from planopt.problems.world_tables import obstacle_table
from planopt.systems.coverage.build import CoverageProblem, build, density_table
from planopt.systems.coverage.check import check, deployment_json, faults
from planopt.systems.coverage.results import (
    EVENTS_FILE,
    NETWORK_FILE,
    Driven,
    in_words,
    run_json,
    tables_of,
)
from planopt.systems.coverage.tables import CoverageFile, PlannerName, PlannerTable

REACHED = ("settled", "served")
"""Outcomes of runs that did what the problem asks."""

PICTURE, ANIMATION, PLAN_PICTURE = "run.png", "run.gif", "plan.png"
NOT_REACHED, NOT_VERIFIED = 4, 3

STARTS = 10
"""Initial deployments of ``solve``; the first is where agents start."""


def drive(
    content: CoverageProblem,
    planner: PlannerTable,
    seed: int,
    on_step: Callable[[], None] = lambda: None,
) -> Driven:
    """Simulate a network; starts, noise and losses come from the seed."""
    generator = np.random.default_rng(seed)
    scene = content.scene(generator)
    run = simulate_network(scene, content.mover(planner), generator, on_step)
    return Driven(content, run, planner.name, planner.horizon, seed)


def planners(content: CoverageProblem, request: Request) -> list[PlannerTable]:
    """Return the planner settings asked for; the laws have one horizon."""
    own = content.given.planner
    return asked_planners(own, request, get_args(PlannerName), with_horizon=("receding",))


def simulate(problem: SystemProblem, request: Request) -> Answer:
    """Simulate one run and judge its moves."""
    content: CoverageProblem = problem.content
    planner = planners(content, request)[0]
    ends_s = [time.perf_counter()]

    def after_step() -> None:
        ends_s.append(time.perf_counter())
        request.on_step()

    driven = drive(content, planner, request.seed, after_step)
    broken = faults(driven)
    data: dict[str, Any] = {"problem": problem.name, **run_json(driven), "faults": broken}
    data["verified_rate"] = 0.0 if broken else 1.0
    lasts_s = np.diff(np.array(ends_s))
    p50, p95 = np.percentile(lasts_s, [50, 95]).tolist()
    data["wall_s"] = ends_s[-1] - ends_s[0]
    data["step_s"] = {"p50": p50, "p95": p95, "max": float(lasts_s.max())}
    reached = data["outcome"] in REACHED
    drawn = content.given.report.figures or request.animation
    return Answer(
        driven,
        data,
        (*in_words(problem.name, data), *(f"  {each}" for each in broken)),
        NOT_VERIFIED if broken else 0 if reached else NOT_REACHED,
        save=lambda folder: write_tables(folder, tables_of(driven)),
        draw=(lambda folder: _draw(problem.name, driven, request, folder)) if drawn else None,
        step_s=tuple(lasts_s.tolist()),
    )


def solve(problem: SystemProblem, request: Request) -> Answer:
    """Find where the network should end: the best of several deployments, with a lower bound."""
    content: CoverageProblem = problem.content
    generator, began = np.random.default_rng(request.seed), time.perf_counter()
    scene = content.scene(generator)
    found = best_deployment(
        content.ground, len(scene.starts_m), STARTS, generator, first_m=scene.starts_m
    )
    data = {
        "problem": problem.name,
        "horizon": None,
        "planner": "several_starts",
        "seed": request.seed,
        "termination": "settled",
        "wall_s": time.perf_counter() - began,
        **deployment_json(content, found.places_m, found.lower_bound),
        "start_costs": found.costs.tolist(),
    }
    worst = float(found.costs.max()) / found.cost
    bound = "none is proved" if data["bound"] is None else f"{data['bound']:.6g}"
    lines = (
        f"{problem.name}: {data['verdict']}, coverage cost {found.cost:.6g}, lower bound {bound}",
        f"  best of {STARTS} starts, the worst of which costs {worst:.4f} times as much",
        *(("  links are not considered: simulate keeps them",) if content.radio else ()),
    )

    def draw(folder: Path) -> None:
        from planopt.report import draw_deployment, save_figure

        shapes = tuple(each.polygon for each in content.obstacles)
        figure = draw_deployment(problem.name, content.ground, shapes, found.places_m, found.cost)
        save_figure(figure, folder / PLAN_PICTURE)

    return Answer(
        found,
        data,
        lines,
        0 if data["verdict"] == "verified" else NOT_VERIFIED,
        draw=draw if content.given.report.figures else None,
    )


def settings(problem: SystemProblem, request: Request) -> list[tuple[int, str]]:
    """Return horizon and planner of each setting that is asked for."""
    return [(each.horizon, each.name) for each in planners(problem.content, request)]


def tables(problem: SystemProblem) -> dict[str, Any]:
    """Return the tables with every default, obstacles as polygons, rasters in place."""
    content: CoverageProblem = problem.content
    found = content.given.model_dump(mode="json", by_alias=True, exclude_none=True)
    found["world"]["obstacles"] = [obstacle_table(each) for each in content.obstacles]
    found["density"] = density_table(content)
    posteriors = () if content.station_map is None else content.station_map.posteriors
    for number, posterior in enumerate(posteriors):
        survey = found["radio"]["survey"][number]
        if survey.pop("file", None) is not None:
            measured = posterior.measurements
            survey["places_m"] = measured.positions_m.tolist()
            survey["power_dbm"] = measured.power_dbm.tolist()
    return found


def words(problem: SystemProblem) -> tuple[str, ...]:
    """Return the problem in lines of text."""
    content: CoverageProblem = problem.content
    given = content.given
    limit = given.agents.speed_max_m_s
    speed = "without a speed limit" if limit is None else f"at most {limit:g} m/s"
    lines = [
        f"{problem.name}: {problem.description}",
        f"  task        coverage, planner {given.planner.name}, steps of "
        f"{given.control.time_step_s:g} s, at most {given.control.duration_s:g} s",
        f"  region      {content.ground.area_m2:g} m^2, {len(content.obstacles)} obstacles, "
        f"density {given.density.kind}",
        f"  agents      {given.agents.start.number}, {speed}; their number is "
        f"{'known' if given.counting.method == 'known' else 'counted: ' + given.counting.method}",
    ]
    for event in content.events:
        x, y = event.place_m
        end = "" if np.isinf(event.ends_s) else f" to {event.ends_s:g} s"
        lines.append(
            f"  event       {event.name} at ({x:g}, {y:g}) m from {event.appears_s:g} s{end}"
        )
    return tuple(lines)


def _draw(name: str, driven: Driven, request: Request, folder: Path) -> None:
    from planopt.report import NetworkPicture, animate_network, draw_network, save_figure

    problem = driven.problem
    shapes = tuple(each.polygon for each in problem.obstacles)
    picture = NetworkPicture(
        name, driven.run, problem.ground, shapes, problem.events, problem.radio
    )
    if problem.given.report.figures:
        save_figure(draw_network(picture), folder / PICTURE)
    if request.animation:
        animate_network(picture, folder / ANIMATION)


SYSTEM = System(
    model=CoverageFile,
    build=build,
    tables=tables,
    words=words,
    files=(NETWORK_FILE, EVENTS_FILE, PICTURE, ANIMATION, PLAN_PICTURE),
    check=check,
    solve=solve,
    simulate=simulate,
    settings=settings,
    animates=True,
)
