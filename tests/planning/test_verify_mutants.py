"""The verifier's own proof: every small falsification of its source changes a judgement.

Each mutant is a change of a few characters in `verify.py`, `searches.py`, `motion.py` or
`shortest_paths.py`. The unchanged source must give the expected verdict for every plan of a table,
and each mutant another one for at least one of them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pytest
import shapely
from mutants import all_hold, module_of, mutated, source_of
from scenes import (
    BAD,
    GOOD,
    RING,
    THRESHOLD_DBM,
    WALL,
    PowerAt,
    bad_band,
    bad_disc,
    bad_everywhere,
    bad_where,
    belief_of,
    good_everywhere,
    small_problem,
)
from unpriced import unpriced

from planopt import Problem
from planopt.channel import ChannelPosterior, condition
from planopt.planning.plan import BEGINNING, History
from planopt.planning.proof.rule import VerifierContext
from planopt.world import index_obstacles

CLEARANCE, BOUNDS, SPEED = "clearance_m", "bounds_m", "speed_max_m_s"
BELOW, NOWHERE = "dB to spare is within reach", "is met at none"
DEAR, NO_PLACE, STANDS = "m was found", "is met nowhere", "stands still"
ALONE = "to compare the plan with"
WASTED = "of the run so far"
KEYS = (CLEARANCE, BOUNDS, SPEED, BELOW, NOWHERE, DEAR, NO_PLACE, STANDS, ALONE, WASTED)
KEYS += ("not finite",)


@dataclass(frozen=True)
class Case:
    """A plan and what must be said of it."""

    path_m: list[tuple[float, float]]
    reasons: set[str] = field(default_factory=set)
    problem: Problem = field(default_factory=small_problem)
    power_at: PowerAt = good_everywhere
    start_m: tuple[float, float] | None = None
    relaxed: tuple[int, ...] = ()
    hopeless: tuple[bool, ...] = ()
    """For each relaxed step, whether no place in reach keeps the bound."""
    cost_m: float | None = None
    best_m: float | None = None
    """Cost of the path and of the cheapest one found, to a metre."""
    clearance_m: float = math.inf
    defect_m: float | None = None
    history: History = BEGINNING
    has_goal: bool = True
    """Whether the robot is to reach a goal; else outage has no price."""
    position_std_m: float = 0.0
    """Of the readings; above zero they do not show the connection at their positions."""


@dataclass(frozen=True)
class Said:
    """What a verifier says of a plan, as far as a case fixes it."""

    verdict: str
    reasons: frozenset[str]
    relaxed: tuple[int, ...]
    hopeless: tuple[bool, ...]
    cost_m: float | None
    best_m: float | None
    clearance_m: float
    defect_m: float | None
    kkt_residual: float | None


def along(*x: float, y: float = 15.0) -> list[tuple[float, float]]:
    return [(each, y) for each in x]


WALLED = small_problem(WALL)
GAP, OPEN_GAP = bad_band(19.0, 23.0), bad_band(19.0, 23.0, open_above_m=20.0)
ACROSS = along(16, 18, 20, 22, 24, 26)
WIDE, OPEN_WIDE = bad_band(15.0, 25.0), bad_band(15.0, 25.0, open_above_m=20.0)
CROSSING, INSIDE = along(10, 12, 14, 16, 18, 20, 22, 24, 26, 28), (3, 4, 5, 6, 7)
LONG_WALL = shapely.box(18.9, -1.0, 19.1, 25.0)
YARD = shapely.Polygon([(8, 8), (22, 8), (22, 22), (8, 22)], [[(9, 9), (21, 9), (21, 21), (9, 21)]])
IN_YARD = bad_where(lambda x, y: (x > 8) & (x < 16) & (y > 8) & (y < 22))


def faint_spot(positions_m: np.ndarray) -> np.ndarray:
    """Good but for one reading just above the threshold: some tenths of a dB miss the bound."""
    at_spot = np.hypot(positions_m[:, 0] - 9.0, positions_m[:, 1] - 15.0) < 1.0
    return np.where(at_spot, THRESHOLD_DBM + 0.1, GOOD)


def island(positions_m: np.ndarray) -> np.ndarray:
    """Bad about (7, 15) but for that very reading, which is just good."""
    away = np.hypot(positions_m[:, 0] - 7.0, positions_m[:, 1] - 15.0)
    return np.where(away < 1.0, THRESHOLD_DBM + 2.0, np.where(away < 6.0, BAD, GOOD))


def good_at_corners(positions_m: np.ndarray) -> np.ndarray:
    """About the first place bad; just good at the corners of the square about the first step."""
    x, y = np.abs(positions_m[:, 0] - 5.0), np.abs(positions_m[:, 1] - 15.0)
    power = np.where(np.maximum(x, y) < 3.5, BAD, GOOD)
    corner = (x > 1.5) & (y > 1.5) & (np.maximum(x, y) < 2.5)
    return np.where(corner, THRESHOLD_DBM + 2.0, power)


def one_good_place(positions_m: np.ndarray) -> np.ndarray:
    """Bad but about one reading, which is no place of a coarse grid through the goal."""
    away = np.hypot(positions_m[:, 0] - 21.0, positions_m[:, 1] - 5.0)
    return np.where(away < 1.0, GOOD, BAD)


def faint_about(positions_m: np.ndarray) -> np.ndarray:
    """Bad in a small disc, and elsewhere a few dB to spare: P(connected) is well below one."""
    return np.where(bad_disc(9, 15, 1.9)(positions_m) < THRESHOLD_DBM, BAD, THRESHOLD_DBM + 0.8)


def charged_below_p_min() -> Problem:
    """The small problem where places that keep the bound cost nothing."""
    problem = small_problem()
    return replace(problem, objective=replace(problem.objective, outage_charge="below_p_min"))


def at_price(price: float) -> Problem:
    """The small problem at a price of outage."""
    problem = small_problem()
    return replace(problem, objective=replace(problem.objective, outage_price=price))


def without_goal(path_m, power_at, missed, *reasons, **more) -> Case:
    """Make a case of missed steps, each with whether no place in reach keeps the bound."""
    hopeless = tuple(missed.values())
    found = {"relaxed": tuple(missed), "hopeless": hopeless, "power_at": power_at}
    return Case(path_m, set(reasons), has_goal=False, **found, **more)


def crossing(cost_m, best_m, *reasons, path_m=CROSSING, power_at=WIDE, relaxed=INSIDE, **more):
    """Make a case of a hole that is crossed, with the cost of the path and of the cheapest."""
    found = {"relaxed": relaxed, "cost_m": cost_m, "best_m": best_m}
    return Case(path_m, set(reasons), power_at=power_at, **found, **more)


ON = along(5, 7, 9, 11, 13)
DAWDLING = along(5, 5, 5, 5, 5, 5, 7, 9, 11)
WANDERING = along(10, 12, 14, 16, 18, 20, 22, 20.93, 22, 20.93, 22, 24, 26, 28)
THERE_AND_BACK = along(16, 18, 20, 22, 20, 18, 16, 18, 20, 22, 20, 18, 16)
LATER = {1: True, 2: True, 3: False, 4: False, 5: False}
CASES: dict[str, Case] = {
    "straight on": Case(ON, defect_m=0.0),
    "one step": Case(along(5, 6.5)),
    "beside a wall": Case([(19.4, 12), (19.4, 14)], problem=WALLED, clearance_m=0.5),
    "too near": Case([(19.401, 12), (19.4, 14)], {CLEARANCE}, WALLED, clearance_m=0.499),
    "through a wall": Case(along(19, 21), {CLEARANCE}, WALLED, clearance_m=0.0),
    "through it first": Case(along(19, 21, 23, 25), {CLEARANCE}, WALLED, clearance_m=0.0),
    "through it last": Case(along(15, 17, 19, 21), {CLEARANCE}, WALLED, clearance_m=0.0),
    "through it, no clearance asked": Case(
        along(19, 21), {CLEARANCE}, small_problem(WALL, clearance_m=0.0), clearance_m=0.0
    ),
    "on the edge": Case(along(36, 38, 40)),
    "out to the right": Case(along(37, 39, 40.5), {BOUNDS}),
    "out and back": Case(along(39, 40.5, 39), {BOUNDS}),
    "too fast first": Case(along(5, 7.001, 8, 9), {SPEED}, defect_m=1e-3),
    "too fast last": Case(along(5, 6, 7, 9.001), {SPEED}, defect_m=1e-3),
    "teleported": Case(along(5.5, 6, 7), {SPEED}, start_m=(5, 15), defect_m=0.5),
    "no number": Case(
        [(5, 15), (math.nan, 15)], {"not finite"}, clearance_m=0.0, defect_m=math.inf
    ),
    "avoidable, first": without_goal(
        [(9, 18.5), (9, 16.6), (9, 18.5), (9, 20)], bad_disc(9, 15, 2.5), {1: False}, BELOW
    ),
    "avoidable, midway": without_goal(ON, bad_disc(9, 15, 1.9), {2: False}, BELOW),
    "avoidable, last": without_goal(along(3, 5, 7, 9), bad_disc(9, 15, 1.9), {3: False}, BELOW),
    "a little below": without_goal(
        along(5, 7, 9), faint_spot, {2: False}, BELOW, position_std_m=1e-6
    ),
    "out of a hole": without_goal(ON, bad_disc(5, 15, 3.5), {1: True}),
    "good beyond the first step's disc": without_goal(
        along(5, 7, 9, 11), good_at_corners, {1: True}
    ),
    "past an island": without_goal(along(5, 6, 7), island, {1: False}, BELOW),
    "dawdling": without_goal(
        [(5, 15), (5, 15), (6.4, 16.4)], bad_disc(5, 15, 1.0), {1: False}, BELOW
    ),
    "not dawdling": without_goal([(5, 15), (6.4, 16.4), (8, 16.4)], bad_disc(5, 15, 1.0), {}),
    "nowhere": without_goal(along(5, 7, 9), bad_everywhere, {1: True, 2: True}, NOWHERE),
    "never again": without_goal(
        [(20, 15), (20, 16), (20, 17)], bad_band(17, 23), {1: True, 2: False}, BELOW, NOWHERE
    ),
    "dawdling deep below": without_goal(
        DAWDLING, bad_disc(5, 15, 5.0), {**LATER, 6: False, 7: False}, BELOW
    ),
    "better place behind a wall": without_goal(
        along(10, 12, 14, 16, 18, 20),
        IN_YARD,
        {1: True, 2: True, 3: True},
        problem=small_problem(YARD, clearance_m=1.0),
        clearance_m=1.0,
    ),
    # 10.4 m to the end of the wall, 0.8 m about it, 1 m on: the seventh step of 2 m.
    "better place round a wall": without_goal(
        along(16, 14, 12, 10, 8, 6, 4, 2, 2, 2, 2, 2, 2),
        bad_band(-1.0, 21.0),
        {step: step < 7 for step in range(1, 13)},
        *(BELOW, NOWHERE),
        problem=small_problem(LONG_WALL),
        clearance_m=2.9,
    ),
    "dawdling at the border": without_goal(
        [(9, 28), (9, 28), (9, 28), (9, 28), (9, 26), (9, 24), (9, 22)],
        bad_where(lambda x, y: y > 24),
        LATER,
        BELOW,
    ),
    "hole with no way round": crossing(105.1, 105.1),
    "hole on a run that has wasted much": crossing(
        105.1, 105.1, WASTED, history=History(crossing_cost_m=50.0, crossing_excess_m=47.0)
    ),
    "hole on a long run that has wasted as much": crossing(
        105.1, 105.1, history=History(crossing_cost_m=80.0, crossing_excess_m=47.0)
    ),
    "first step back on a run that has wasted some": crossing(
        *(105.1, 101.1, WASTED),
        path_m=along(14, 12, 14, 16, 18, 20, 22, 24, 26, 28),
        history=History(crossing_cost_m=20.0, crossing_excess_m=43.0),
    ),
    "hole with a way round": crossing(105.4, 29.6, DEAR, power_at=OPEN_WIDE),
    "hole with a way round that is dearer": crossing(
        27.4, 27.4, problem=at_price(0.3), power_at=OPEN_WIDE
    ),
    "small hole with a way round": crossing(
        52.7, 22.9, path_m=ACROSS, power_at=OPEN_GAP, relaxed=(2, 3)
    ),
    "into a hole and back": crossing(
        338.2, 94.1, DEAR, path_m=THERE_AND_BACK, relaxed=tuple(range(1, 13))
    ),
    "as dear as is tolerated": crossing(
        152.2, 105.1, path_m=WANDERING, relaxed=tuple(range(3, 12))
    ),
    # Outside the workspace no way may be found.
    "hole with a way round beside a wall outside": crossing(
        *(107.4, 106.6),
        path_m=along(10, 12, 14, 16, 18, 20, 22, 24, 26, 28, y=9.0),
        problem=small_problem(shapely.box(18, -40, 24, -0.5)),
        clearance_m=9.5,
    ),
    "hole with a way closed": crossing(
        *(105.4, 105.7),
        problem=small_problem(shapely.box(13, 18, 27, 30)),
        power_at=OPEN_WIDE,
        clearance_m=3.0,
    ),
    "beside a thin wall": crossing(
        *(118.4, 111.9),
        path_m=[(14.5, 15), (16.5, 15), (18.5, 15)],
        problem=small_problem(LONG_WALL, clearance_m=0.1),
        power_at=bad_where(lambda x, y: (x > 12) & (x < 18.9)),
        relaxed=(1,),
        clearance_m=0.4,
    ),
    "out of a closed yard": crossing(
        *(math.inf, math.inf, ALONE),
        path_m=along(18, 20, 22),
        problem=small_problem(RING),
        power_at=bad_disc(20, 15, 1.9),
        clearance_m=4.0,
        relaxed=(1,),
    ),
    "nowhere at all": crossing(
        330.0, 330.0, NO_PLACE, path_m=along(5, 7, 9), power_at=bad_everywhere, relaxed=(1, 2)
    ),
    "hole in faint contact": crossing(
        *(130.7, 136.5),
        path_m=along(5, 7, 9, 11),
        power_at=faint_about,
        relaxed=(2,),
        position_std_m=1e-6,
    ),
    "hole in faint contact, charged where it misses the bound": crossing(
        *(128.8, 136.3),
        path_m=along(5, 7, 9, 11),
        problem=charged_below_p_min(),
        power_at=faint_about,
        relaxed=(2,),
        position_std_m=1e-6,
    ),
    "at one place only": crossing(
        330.0, 330.0, path_m=along(5, 7, 9), power_at=one_good_place, relaxed=(1, 2)
    ),
    "standing still": Case(along(5, 5, 5), {STANDS}),
    "standing still after a step": Case(along(5, 6, 6)),
    "standing at the goal": Case(along(34.5, 34.5, 34.5)),
    "courtyard": Case(along(18, 20, 22), problem=small_problem(RING), clearance_m=4.0),
}

VERIFY, MOTION = "planopt.planning.proof.verify", "planopt.planning.proof.motion"
SEARCHES, ROUND = "planopt.planning.proof.searches", "planopt.world.shortest_paths"
MODULES = (VERIFY, SEARCHES, ROUND, MOTION)


def verifier_of(sources: dict[str, str]) -> Callable[..., tuple]:
    """The verifier of the texts, by module."""
    modules = {module: module_of(module, sources[module]) for module in MODULES}
    for user, used, names in (
        (SEARCHES, ROUND, ("is_near_joined", "shortest_paths", "path_lengths_m")),
        (VERIFY, SEARCHES, ("best_margins_by_step", "build_goal_grid", "goal_costs", "price_path")),
        (VERIFY, MOTION, ("verify_motion",)),
    ):
        for name in names:
            setattr(modules[user], name, getattr(modules[used], name))
    return modules[VERIFY].verify


def verdict_of(case: Case) -> str:
    """Standing still, and what cannot be compared, is feasible, but not verified."""
    if case.reasons and case.reasons <= {STANDS, ALONE}:
        return "feasible_unverified"
    return "violated" if case.reasons else "verified"


def rounded(metres: float | None) -> float | None:
    return None if metres is None else round(metres, 1)


def expected(case: Case) -> Said:
    """What must be said of a case."""
    return Said(
        verdict=verdict_of(case),
        reasons=frozenset(case.reasons),
        relaxed=case.relaxed,
        hopeless=case.hopeless,
        cost_m=case.cost_m,
        best_m=case.best_m,
        clearance_m=case.clearance_m,
        defect_m=case.defect_m,
        kkt_residual=0.125,
    )


def posterior_of(problem: Problem, case: Case) -> ChannelPosterior:
    posterior = belief_of(problem, case.power_at).posterior
    if case.position_std_m == 0.0:
        return posterior
    deviations = np.full(len(posterior.measurements), case.position_std_m)
    measured = replace(posterior.measurements, position_std_m=deviations)
    return condition(posterior.parameters, measured, theta="known")


def said(verifier: Callable[..., tuple], case: Case) -> Said:
    """What a verifier says of a case."""
    path = np.array(case.path_m, dtype=float)
    start = path[0] if case.start_m is None else np.array(case.start_m)
    problem = case.problem if case.has_goal else unpriced(case.problem)
    context = VerifierContext(
        problem,
        index_obstacles(problem.workspace),
        (posterior_of(problem, case),),
        start,
        history=case.history,
    )
    found = verifier(context, path, 0.125)
    certificate, verdict = found.certificate, found.verdict
    shown = [[key for key in KEYS if key in reason] for reason in certificate.reasons]
    return Said(
        verdict=verdict.value,
        reasons=frozenset(keys[0] if keys else "?" for keys in shown),
        relaxed=certificate.relaxed_steps,
        hopeless=tuple(best < 0.0 for best in certificate.best_margin_db),
        cost_m=rounded(certificate.path_cost_m),
        best_m=rounded(certificate.best_cost_m),
        clearance_m=round(certificate.min_clearance_m, 6),
        defect_m=None if case.defect_m is None else round(certificate.dynamics_defect, 6),
        kkt_residual=certificate.kkt_residual,
    )


@pytest.mark.parametrize("name", CASES)
def test_source_as_it_is(name):
    """Every plan is judged as it must be, by the very texts that are mutated below."""
    verifier = verifier_of({module: source_of(module) for module in MODULES})
    assert said(verifier, CASES[name]) == expected(CASES[name])


# Module, original text, which occurs once, and the text of the mutant.
MUTANTS = (
    (VERIFY, "if not np.isfinite(positions_m).all():", "if False:"),
    (MOTION, ".clearance_m, CLEARANCE_TOLERANCE_M)", ".clearance_m, 1e6 * CLEARANCE_TOLERANCE_M)"),
    (MOTION, ".clearance_m, CLEARANCE_TOLERANCE_M)", ".clearance_m, -CLEARANCE_TOLERANCE_M)"),
    (MOTION, "if is_clear(swept", "if not is_clear(swept"),
    (MOTION, "is_clear(swept, constraints.", "is_clear(swept, 0.0 * constraints."),
    (MOTION, "is_clear(swept, constraints.clearance_m, ", "(swept >= constraints.clearance_m - "),
    (MOTION, "CLEARANCE_TOLERANCE_M).all()", "CLEARANCE_TOLERANCE_M).any()"),
    (MOTION, "np.min(swept, initial=np.inf)", "np.max(swept, initial=-np.inf)"),
    (MOTION, "swept_clearance_m(index, positions_m)", "swept_clearance_m(index, positions_m[:-1])"),
    (MOTION, "swept_clearance_m(index, positions_m)", "swept_clearance_m(index, positions_m[1:])"),
    (MOTION, "(index, positions_m)", "(index, np.repeat(positions_m, 2, axis=0))[::2]"),
    (MOTION, "(problem.workspace, positions_m).all()", "(problem.workspace, positions_m).any()"),
    (MOTION, "(problem.workspace, positions_m).all()", "(problem.workspace, positions_m)[-1]"),
    (MOTION, "not inside_bounds(problem.workspace, ", "inside_bounds(problem.workspace, "),
    (MOTION, "defect > DYNAMICS_TOLERANCE_M", "defect > 1e6 * DYNAMICS_TOLERANCE_M"),
    (MOTION, "defect > DYNAMICS_TOLERANCE_M", "defect < -DYNAMICS_TOLERANCE_M"),
    (MOTION, "(positions_m, start_m,", "(positions_m, positions_m[0],"),
    (MOTION, "(positions_m, start_m,", "(positions_m[:-1], start_m,"),
    (
        VERIFY,
        " power.mean_db[1:], power.deviation_db[1:",
        " power.mean_db[:-1], power.deviation_db[:-1",
    ),
    (VERIFY, ", radio.threshold_dbm, constraints.p_min)", ", radio.threshold_dbm, 0.5)"),
    (VERIFY, " = bound_margin_db(mean, deviation,", " = bound_margin_db(mean, 0.0 * deviation,"),
    (VERIFY, "margins < -MARGIN_TOLERANCE_DB", "margins < -1e6 * MARGIN_TOLERANCE_DB"),
    (VERIFY, "margins < -MARGIN_TOLERANCE_DB", "margins > MARGIN_TOLERANCE_DB"),
    (VERIFY, "& counted)[0] + 1", "& asked)[0]"),
    (VERIFY, "        if margin >= 0.0\n", "        if margin < 0.0\n"),
    (VERIFY, "if len(missed) == count:", "if False:"),
    (VERIFY, "        if margin >= 0.0\n    ][:1]", "    ][:0]"),
    (VERIFY, "if is_priced(problem):", "if False:"),
    (VERIFY, "if is_priced(problem):", "if True:"),
    (VERIFY, "=tuple(_too_dear(problem, context.history, priced, best_margin_db)),", "=(),"),
    (VERIFY, " best_margin_db < -MARGIN_TOLERANCE_DB:", " best_margin_db > MARGIN_TOLERANCE_DB:"),
    (VERIFY, "if best_margin_db < -MARGIN_TOLERANCE_DB:", "if False:"),
    (VERIFY, "spent = history.crossing_excess_m +", "spent ="),
    (VERIFY, " = history.crossing_excess_m + priced.excess_m", " = history.crossing_excess_m"),
    (VERIFY, " * (history.crossing_cost_m + priced.step_m)", " * priced.step_m"),
    (VERIFY, "if spent > allowed:", "if spent < allowed:"),
    (SEARCHES, "excess = step + after - best if", "excess = after - best if"),
    (SEARCHES, "after = rest_m(min(1, len(lengths)))", "after = rest_m(0)"),
    (VERIFY, "within = priced.cost_m <= (1.0", "within = priced.cost_m > (1.0"),
    (VERIFY, "(1.0 + COST_TOLERANCE)", "(0.5 + COST_TOLERANCE)"),
    (VERIFY, "(1.0 + COST_TOLERANCE)", "(1.0 + 0.0 * COST_TOLERANCE)"),
    (VERIFY, "(1.0 + COST_TOLERANCE)", "(1.0 + 50.0 * COST_TOLERANCE)"),
    (VERIFY, "leeway = COST_LEEWAY_STEPS", "leeway = 0.0"),
    (VERIFY, "leeway = COST_LEEWAY_STEPS", "leeway = 0.5 * COST_LEEWAY_STEPS"),
    (VERIFY, "leeway = COST_LEEWAY_STEPS", "leeway = 2.0 * COST_LEEWAY_STEPS"),
    (VERIFY, "problem.step_length_m * (1.0 + price)", "problem.step_length_m"),
    (VERIFY, "chance, margin < -", "0.5 * chance, margin < -"),
    (VERIFY, " < -MARGIN_TOLERANCE_DB, everywhere)", " > -MARGIN_TOLERANCE_DB, everywhere)"),
    (VERIFY, ", margin < -MARGIN_TOLERANCE_DB, everywhere)", ", margin < np.inf, everywhere)"),
    (VERIFY, ", margin < -MARGIN_TOLERANCE_DB, everywhere)", ", margin < -MARGIN_TOLERANCE_DB)"),
    (VERIFY, "path_cost_m=priced.cost_m,", "path_cost_m=None,"),
    (VERIFY, "path_cost_m=priced.cost_m,", "path_cost_m=priced.best_m,"),
    (SEARCHES, "price * charged_length_m(lengths, share", "0.0 * charged_length_m(lengths, share"),
    (SEARCHES, "driven = float(lengths.sum()) +", "driven ="),
    (SEARCHES, "PricedPath(driven + rest_m(len(positions_m) - 1),", "PricedPath(driven,"),
    (SEARCHES, "(driven + rest_m(len(positions_m) - 1),", "(driven + rest_m(0),"),
    (SEARCHES, "    best = rest_m(0)\n", "    best = rest_m(len(positions_m) - 1)\n"),
    (SEARCHES, "grid.nodes_m[near]) > 0.0]", "grid.nodes_m[near]) > -1.0]"),
    (SEARCHES, "grid.nodes_m[near]) > 0.0]", "grid.nodes_m[near]) > np.inf]"),
    (SEARCHES, "joining = away[near] * (1.0 +", "joining = 0.0 * away[near] * (1.0 +"),
    (SEARCHES, "<= JOINING_SPACINGS *", "<= 9.0 * JOINING_SPACINGS *"),
    (SEARCHES, "5 * price * (costs.share[near] + share", "0 * price * (costs.share[near] + share"),
    (SEARCHES, "5 * price * (share[one] + share[other]", "0 * price * (share[one] + share[other]"),
    (SEARCHES, "0.5 * price * (share[one] + share[", "1.0 * price * (share[one] + share["),
    (SEARCHES, "(graph, directed=False,", "(graph, directed=True,"),
    (SEARCHES, "indices=grid.goal", "indices=0"),
    (SEARCHES, "at_goal = int(np.argmin(", "at_goal = int(np.argmax("),
    (SEARCHES, "kept[doubtful] = is_clear(swept, clearance)", "pass"),
    (SEARCHES, "kept[doubtful] = is_clear(swept, clearance)", "kept[doubtful] = False"),
    (SEARCHES, "least < clearance +", "least < -9.0 +"),
    (SEARCHES, "(1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))", "(1, 0))"),
    (SEARCHES, ", (1, 2), (2, 1), (1, -2), (2, -1))", ")"),
    (SEARCHES, "rows // COARSE + down", "rows // COARSE + right"),
    (SEARCHES, "by_y = share_y if down", "by_y = share_y if right"),
    (SEARCHES, "best = max(best, float(contact_at(grid.nodes_m)[1].max()))", "pass"),
    (VERIFY, "[STANDING] if _gets_nowhere(", "[STANDING] if False and _gets_nowhere("),
    (VERIFY, "not is_compared else", "False else"),
    (VERIFY, "or is_at_goal(problem, positions_m[0])", ""),
    (VERIFY, "(track - track[0]).max() <=", "(track - track[0]).min() <="),
    (
        VERIFY,
        "VIOLATED if reasons else Verdict.VERIFIED",
        "VERIFIED if reasons else Verdict.VIOLATED",
    ),
    (VERIFY, "Verdict.VIOLATED if reasons else Verdict.VERIFIED", "Verdict.VERIFIED"),
    (VERIFY, "        kkt_residual=kkt_residual,\n", "        kkt_residual=None,\n"),
    (SEARCHES, " = float(step) * step_length_m", " = (float(step) - 1.0) * step_length_m"),
    (SEARCHES, " = float(step) * step_length_m", " = (float(step) + 1.0) * step_length_m"),
    (SEARCHES, "reach = float(step) * step_length_m", "reach = step_length_m"),
    (SEARCHES, "np.ones((3, 3)", "np.eye(3"),
    (SEARCHES, "[..., 1] = anchor_m[1] + rows[:, None]", "[..., 1] = anchor_m[1] - rows[:, None]"),
    (SEARCHES, "reached = chunk[length[chunk] <= reach]", "reached = chunk"),
    (SEARCHES, "reached = chunk[length[chunk] <= reach]", "reached = chunk[:0]"),
    (ROUND, "free[np.flatnonzero(free)[hit]] = False", "pass"),
    (ROUND, '("crosses", "within")', '("within",)'),
    (ROUND, "length[seen], before[seen] = through[seen], turn", "pass"),
    (ROUND, "through = driven + _away(corners_m, here)", "through = _away(corners_m, here)"),
    (SEARCHES, "np.searchsorted(distance, reach,", "np.searchsorted(distance, 9.0 * reach,"),
    (SEARCHES, "(from_start <= radius)\n", "(from_start > radius)\n"),
)


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: f"{mutant[0][17:]}: {mutant[2]}")
def test_mutant_is_found_out(mutant):
    """At least one plan is judged otherwise, or not at all."""
    changed = mutant[0]
    sources = {module: source_of(module) for module in MODULES} | {changed: mutated(*mutant)}
    verifier = verifier_of(sources)

    def is_judged_right(case: Case) -> None:
        assert said(verifier, case) == expected(case)

    # The cases that are about the changed text first.
    cases = sorted(CASES.values(), key=lambda case: (case.cost_m is None) == (changed == SEARCHES))
    assert not all_hold(partial(is_judged_right, case) for case in cases)
