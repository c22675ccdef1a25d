"""Verification of capture guarantees and network designs from their parameters.

The formulas of docs/theory/pursuit.md are implemented a second time, independently of the design
search and of the classes for services and guarantees. A guarantee is accepted if its inequalities
hold, its floor and capture time are no smaller than the values computed here, and the logged stages
and captures satisfy its bounds.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
import shapely

from planopt.arrays import Floats, Indices
from planopt.pursuit.levels import LevelBounds
from planopt.pursuit.verify import PursuitData, PursuitLog, Violation


class Distances(Enum):
    """Kind of distance in a guarantee: straight, or along shortest paths."""

    STRAIGHT = "straight"
    PATHS = "paths"


class Theorem(Enum):
    """Theorem on which a guarantee is based."""

    LEMMA = "lemma"
    ANY_INSTANT = "any_instant"
    SAMPLED_DISTANCE = "sampled_distance"
    SNAPSHOTS = "snapshots"


@dataclass(frozen=True)
class Inequality:
    """Inequality ``left < right`` with its description."""

    words: str  # Description of the inequality
    left: float  # Both sides, in `unit` ("" for ratios)
    right: float
    unit: str = ""
    strict: bool = True  # Whether equality is a failure; loads and margins may be met exactly

    @property
    def holds(self) -> bool:
        """Return True if the inequality holds, strictly or up to rounding."""
        if self.strict:
            return self.left < self.right
        return self.left <= self.right * (1.0 + ROUNDING)

    @property
    def margin(self) -> float:
        """Return the right side minus the left side; negative if the inequality fails."""
        return self.right - self.left

    def __str__(self) -> str:
        if self.holds and not self.left < self.right:
            return f"{self.words}: met exactly"
        unit = f" {self.unit}" if self.unit else ""
        relation = f"{self.margin:.4g}{unit} below" if self.holds else "not below"
        return f"{self.words}: {self.left:.6g}{unit} is {relation} {self.right:.6g}{unit}"


ROUNDING = 1e-9  # Relative rounding tolerance of requirements that are met with equality
SLACK = 1e-6  # Relative tolerance of claimed numbers
INTERVALS = 1000  # Number of intervals of the integral that bounds the capture time from above
REPORT_SHARE = 2.0
"""Factor on report errors among obstacles: moving a report to free space may double its error."""
TURN_SEGMENTS = 2  # Straight segments per quarter turn of a path around an obstacle vertex
RING_SAMPLES = 100  # Number of boundary points between which detours are compared with chords


@dataclass(frozen=True)
class Case:
    """Speeds of a chase, and bounds on age and error of records at distance d."""

    evader_m_s: float
    pursuer_m_s: float
    delay_s: float  # Time of a stage in addition to straight driving and waiting
    age_s_m: float  # Age is at most max(age_s_m d, least_age_s)
    error: float  # Error is at most max(error d, least_error_m)
    least_age_s: float
    least_error_m: float
    period_s_m: float  # Time between rounds per metre of distance
    spacing_m: float  # Side of the finest cells
    reach_m: float = math.inf  # Distance up to which a record exists
    open_space: bool = True

    @property
    def moved(self) -> float:
        """Return the evader displacement during a record's age, per metre of distance."""
        return self.age_s_m * self.evader_m_s

    @property
    def contraction(self) -> float:
        """Return the ratio of the distances after and before a stage with fresh records."""
        ratio = self.evader_m_s / self.pursuer_m_s
        return ratio + self.error * (1.0 + ratio)

    @property
    def lag(self) -> float:
        """Return the evader displacement between rounds per metre of distance."""
        return self.period_s_m * self.evader_m_s

    @property
    def levels(self) -> LevelBounds:
        """Return the pursuit's distance bounds for each level of the snapshot service."""
        period_s = 0.5 * self.period_s_m * self.spacing_m
        return LevelBounds(
            *(self.evader_m_s, self.pursuer_m_s, self.delay_s, self.spacing_m),
            *(self.least_age_s - period_s, period_s, self.error, self.least_error_m),
            self.open_space,
        )

    def start_m(self, distance_m: float) -> float:
        """Return the distance bound at the first record, from the evader's sampled distance."""
        return distance_m + self.evader_m_s * max(self.age_s_m * distance_m, self.least_age_s)

    def least_distance_m(self, bound_m: Floats) -> Floats:
        """Return the sampled distances at which :meth:`start_m` equals `bound_m`, at least 0."""
        moved_m = self.evader_m_s * self.least_age_s
        return np.maximum(0.0, np.minimum(bound_m / (1.0 + self.moved), bound_m - moved_m))


def premises(theorem: Theorem, case: Case) -> list[Inequality]:
    """Return the inequalities required by a theorem."""
    if case.evader_m_s >= case.pursuer_m_s:
        words = "evader's speed below the pursuer's"
        return [Inequality(words, case.evader_m_s, case.pursuer_m_s, "m/s")]
    a, x = case.contraction, case.moved
    if theorem is Theorem.LEMMA:
        return [Inequality("a + x below 1", a + x, 1.0)]
    if theorem is Theorem.ANY_INSTANT:
        left = a + (1.0 - case.evader_m_s / case.pursuer_m_s) * x
        return [Inequality("a + (1 - 1/alpha) x below 1", left, 1.0)]
    if theorem is Theorem.SAMPLED_DISTANCE:
        return [Inequality("a below 1", a, 1.0)]
    found = [Inequality("y = v_e period below 1", case.lag, 1.0)]
    if case.lag < 1.0:
        share = 1.0 / (1.0 - case.lag)
        wider = replace(case, age_s_m=share * case.age_s_m, error=share * case.error)
        waits = wider.error * (1.0 + wider.moved)
        found.append(Inequality("a of the error over 1 - y below 1", wider.contraction, 1.0))
        found.append(Inequality("growth while waiting below 1", waits, 1.0))
    return found


def stages(theorem: Theorem, case: Case, before_m: Floats) -> list[tuple[Floats, Floats]]:
    """Return next bounds (k,) and durations (k,) of each kind of stage, for bounds (k,)."""
    # The bound is on W, for the Lemma on the sampled distance. All premises must hold. Snapshots
    # are bounded by level instead.
    age_m = np.maximum(case.moved * before_m, case.evader_m_s * case.least_age_s)
    if theorem is Theorem.LEMMA:
        sampled_m, far_m, left_m = before_m, before_m, age_m
    elif theorem is Theorem.ANY_INSTANT:
        sampled_m = np.maximum(0.0, before_m - age_m)
        far_m, left_m = before_m, before_m - sampled_m
    else:
        sampled_m = case.least_distance_m(before_m)
        far_m, left_m = sampled_m, before_m - sampled_m
    error_m = np.maximum(case.error * far_m, case.least_error_m)
    drive_s = (sampled_m + error_m) / case.pursuer_m_s + case.delay_s
    found = [(left_m + error_m + case.evader_m_s * drive_s, drive_s)]
    if theorem is not Theorem.SAMPLED_DISTANCE:
        error_m = np.maximum(case.error * before_m, case.least_error_m)
        oldest_s = case.age_s_m / (1.0 - case.moved) * error_m
        wait_s = np.maximum(case.least_age_s, oldest_s) + case.delay_s
        found.append((error_m + case.evader_m_s * wait_s, wait_s))
    return found


def next_bound_m(theorem: Theorem, case: Case, before_m: Floats) -> Floats:
    """Return the largest distance bound (k,) after any stage, for the bounds before the stage."""
    if theorem is Theorem.SNAPSHOTS:
        return case.levels.next_bound_m(before_m)
    return np.max([after for after, _ in stages(theorem, case, before_m)], axis=0)


def floor_m(theorem: Theorem, case: Case) -> float:
    """Return the largest bound without guaranteed reduction; infinite if a premise fails."""
    if not all(each.holds for each in premises(theorem, case)):
        return math.inf
    if theorem is Theorem.SNAPSHOTS:
        return case.levels.floor_m()
    grid: Floats = np.geomspace(1e-9, 1e15, 2001)
    grid[0] = 0.0
    for _ in range(8):
        lifted = np.flatnonzero(next_bound_m(theorem, case, grid) > grid)
        if not len(lifted):
            return 0.0
        if lifted[-1] + 1 == len(grid):
            return math.inf
        grid = np.linspace(float(grid[lifted[-1]]), float(grid[lifted[-1] + 1]), 101)
    found = float(grid[-1])
    return case.start_m(found) if theorem is Theorem.LEMMA else found


def capture_time_s(theorem: Theorem, case: Case, distance_m: float, radius_m: float) -> float:
    """Return the bound on the capture time, given the first sampled distance; inf if unbounded."""
    if not floor_m(theorem, case) < radius_m:
        return math.inf
    if theorem is Theorem.SNAPSHOTS:
        if case.levels.start_m(distance_m) > case.reach_m:
            return math.inf
        return case.levels.capture_time_s(distance_m, radius_m)
    first, last = case.start_m(distance_m), radius_m
    if theorem is Theorem.LEMMA:
        first, last = case.least_distance_m(np.array([first, last])).tolist()
    if first <= last:
        return 0.0
    grid = np.geomspace(last, first, INTERVALS + 1)
    # Decrease of W times (maximum duration / decrease), which falls with W, bounds a stage's time.
    pace = np.zeros(INTERVALS)
    for after, lasts_s in stages(theorem, case, grid[:-1]):
        pace = np.maximum(pace, lasts_s / (grid[:-1] - after))
    return float((pace * np.diff(grid)).sum() + pace[0] * last)


@dataclass(frozen=True)
class DesignData:
    """Network design with the pursuit for which it was made."""

    evader_speed_m_s: float
    pursuer_speed_m_s: float
    stage_delay_s: float
    mote_spacing_m: float
    bit_rate_bit_s: float
    header_bits: float
    record_bits: float
    slots_per_frame: int
    slot_blocks: int
    margin: float  # Minimum of 1 - contraction - staleness if no capture radius is required
    first_distance_m: float | None
    capture_radius_m: float | None
    deadline_s: float | None


def certify(
    data: DesignData, theorem: Theorem, slot_width_s: float, rate_divisor: int, bits_per_axis: int
) -> tuple[Inequality, ...]:
    """Return every requirement on a network design, satisfied or not."""
    payload = data.header_bits + data.slot_blocks * (data.record_bits + 2 * bits_per_axis)
    carried = data.bit_rate_bit_s * slot_width_s
    words = "payload of a slot below what it carries"
    found = [Inequality(words, payload, carried, "bit", strict=False)]
    # A level-j round takes 3 * 2^j frames and starts every r-th time; 2^j < 2 d in mote spacings.
    frame_s = data.slots_per_frame * slot_width_s
    case = Case(
        data.evader_speed_m_s,
        data.pursuer_speed_m_s,
        data.stage_delay_s,
        6.0 * (1 + rate_divisor) * frame_s / data.mote_spacing_m,
        math.sqrt(2.0) / 2.0**bits_per_axis,
        3.0 * (1 + rate_divisor) * frame_s,
        math.sqrt(0.5) * data.mote_spacing_m,
        6.0 * rate_divisor * frame_s / data.mote_spacing_m,
        data.mote_spacing_m,
    )
    radius_m, first_m, deadline_s = data.capture_radius_m, data.first_distance_m, data.deadline_s
    if radius_m is None:
        left = case.contraction + case.moved
        found += [
            Inequality("a + x below 1", left, 1.0),
            Inequality("a + x + margin below 1", left + data.margin, 1.0, strict=False),
        ]
    else:
        floor = floor_m(theorem, case)
        found += premises(theorem, case)
        found.append(Inequality("floor below the capture radius", floor, radius_m, "m"))
    if deadline_s is not None and first_m is not None:
        if radius_m is None:
            left = 1.0 - case.contraction - case.moved
            first_s = (1.0 + case.error) * first_m / data.pursuer_speed_m_s
            longest_s = first_s / left if left > 0.0 else math.inf
        else:
            longest_s = capture_time_s(theorem, case, first_m, radius_m)
        words, strict = "time to capture below the deadline", radius_m is not None
        found.append(Inequality(words, longest_s, deadline_s, "s", strict))
    return tuple(found)


@dataclass(frozen=True)
class Claim:
    """Guarantee of one theorem, claimed by a saved run for its first pursuer and first evader."""

    theorem: Theorem
    distances: Distances
    holds: bool
    captures: bool  # Whether the floor is below the capture radius
    capture_time_s: float | None  # None if no time is guaranteed


def flaws_of(loss_probability: float, unnamed: bool) -> tuple[Inequality, ...]:
    """Return the premises, common to all theorems, that losses or unnamed reports violate."""
    shares = {
        "share of lost records": loss_probability,
        "share of records without the evader's name": float(unnamed),
    }
    return tuple(Inequality(words, share, 0.0) for words, share in shares.items() if share > 0.0)


def verify_guarantees(
    data: PursuitData, log: PursuitLog, claims: tuple[Claim, ...], detour: float
) -> list[Violation]:
    """Return violations: wrong detour factor, unproven claims, and bounds that the log exceeds."""
    found: list[Violation] = []
    least = _least_detour(data)
    if not least <= detour * (1.0 + SLACK):
        found.append(Violation("guarantee", f"paths are up to {least:.6g} times as long as chords"))
    alone = len(data.pursuers) == len(data.evaders) == 1
    for claim in claims:
        name, radius_m = claim.theorem.value, data.capture_radius_m
        case = _case(data, 0, 0, claim.distances, detour)
        needs, floor = premises(claim.theorem, case), floor_m(claim.theorem, case)
        service = data.service
        needs = [*flaws_of(service.loss_probability, service.detection is not None), *needs]
        if claim.holds and not all(each.holds for each in needs):
            failing = next(each for each in needs if not each.holds)
            found.append(Violation("guarantee", f"{name}: {failing}"))
            continue
        if claim.holds and claim.captures and not floor < radius_m * (1.0 + SLACK):
            found.append(Violation("guarantee", f"{name}: stages end at {floor:.6g} m"))
        if claim.holds and data.planner == "drive":
            found += _stage_faults(data, log, claim, detour)
        if not alone or claim.capture_time_s is None or not len(log.reports.time_s):
            continue
        distance_m, first_s = _sampled_away_m(log, 0)[0], float(log.reports.time_s[0])
        least_s = capture_time_s(claim.theorem, case, distance_m, radius_m)
        if not least_s <= claim.capture_time_s * (1.0 + SLACK):
            found.append(Violation("guarantee", f"{name}: capture may take {least_s:.6g} s"))
        spent_s = min(float(log.capture_s[0]), float(log.times_s[-1])) - first_s
        if data.planner == "drive" and spent_s > claim.capture_time_s * (1.0 + ROUNDING):
            text = f"{name}: no capture within {claim.capture_time_s:.6g} s"
            found.append(Violation("guarantee", text))
    return found


def _stage_faults(
    data: PursuitData, log: PursuitLog, claim: Claim, detour: float
) -> Iterator[Violation]:
    """Yield a violation for each chase with a stage above the bound from the previous stage."""
    # Path lengths are only known to lie between the chord and `detour` times the chord.
    reports = log.reports
    longest = detour if claim.distances is Distances.PATHS else 1.0
    for pursuer, evader in sorted(set(reports.pairs)):
        rows = np.flatnonzero((reports.pursuer == pursuer) & (reports.evader == evader))
        case = _case(data, pursuer, evader, claim.distances, detour)
        if len(rows) < 2 or not all(each.holds for each in premises(claim.theorem, case)):
            continue
        away_m = _sampled_away_m(log, rows)
        moved_m = case.evader_m_s * (reports.time_s[rows] - reports.sampled_s[rows])
        allowed_m = next_bound_m(claim.theorem, case, longest * away_m[:-1] + moved_m[:-1])
        share = float(((away_m + moved_m)[1:] / allowed_m).max())
        if share > 1.0 + ROUNDING:
            yield Violation(
                "stages",
                f"{claim.theorem.value}: a stage of {data.pursuers[pursuer].name} after "
                f"{data.evaders[evader].name} exceeds its bound by {100.0 * (share - 1.0):.3g} %",
            )


def _sampled_away_m(log: PursuitLog, rows: Indices | int) -> Floats:
    """Return the distances (k,) of the pursuer from the evader's sampled positions."""
    reports, found = log.reports, list[float]()
    for row in np.atleast_1d(rows).tolist():
        step = int(np.abs(log.times_s - reports.time_s[row]).argmin())
        sampled_m = log.evader_at(int(reports.evader[row]), reports.sampled_s[row : row + 1])[0]
        here_m = log.states[int(reports.pursuer[row])][step, :2]
        found.append(math.dist(here_m, sampled_m))
    return np.array(found)


def _case(
    data: PursuitData, pursuer: int, evader: int, distances: Distances, detour: float
) -> Case:
    """Return the bounds of one chase; obstacles enlarge errors or reduce the pursuer's speed."""
    service, robot = data.service, data.pursuers[pursuer]
    turn_s = 0.0 if robot.turn_rate_max_rad_s is None else math.pi / robot.turn_rate_max_rad_s
    round_s_m = 2.0 * service.hops_per_round * service.frame_s / service.mote_spacing_m
    rounds = 1 + service.rate_divisor
    case = Case(
        max(data.evaders[evader].speed_max_m_s, 1e-9),
        robot.speed_max_m_s,
        (1 + _corners(data)) * (data.step_s + turn_s),
        rounds * round_s_m,
        math.sqrt(2.0) * 0.5**service.bits_per_axis,
        rounds * service.hops_per_round * service.frame_s,
        math.sqrt(0.5) * service.mote_spacing_m,
        service.rate_divisor * round_s_m,
        service.mote_spacing_m,
        service.mote_spacing_m * 2.0**service.levels if service.endless else math.inf,
    )
    if not data.obstacles:
        return case
    wider = REPORT_SHARE * (detour if distances is Distances.PATHS else 1.0)
    slower = 1.0 if distances is Distances.PATHS else detour
    return replace(
        case,
        pursuer_m_s=case.pursuer_m_s / slower,
        error=wider * case.error,
        least_error_m=wider * case.least_error_m,
        open_space=False,
    )


def _grown(data: PursuitData) -> list[shapely.Geometry]:
    """Return the obstacles, inflated so that chords of the rounded vertices keep the clearance."""
    by_m = data.clearance_m / math.cos(0.25 * math.pi / TURN_SEGMENTS)
    return [shapely.buffer(each, by_m, quad_segs=TURN_SEGMENTS) for each in data.obstacles]


def _corners(data: PursuitData) -> int:
    """Return the number of convex vertices, at which shortest paths may turn."""
    count = 0
    for part in shapely.get_parts(_grown(data)):
        for ring in shapely.get_rings(shapely.orient_polygons(part)):
            side = np.diff(shapely.get_coordinates(ring), axis=0)
            following = np.roll(side, -1, axis=0)
            count += int((side[:, 0] * following[:, 1] > side[:, 1] * following[:, 0]).sum())
    return count


def _least_detour(data: PursuitData) -> float:
    """Return a lower bound on the detour factor, from pairs of points on free-space boundaries."""
    if not data.obstacles or data.bounds_m is None:
        return 1.0
    free = shapely.box(*data.bounds_m).difference(shapely.union_all(_grown(data)))
    shapely.prepare(free)
    least = 1.0
    for ring in shapely.get_rings(shapely.get_parts(free)):
        length_m = float(ring.length)
        along_m = length_m * np.arange(RING_SAMPLES) / RING_SAMPLES
        places = shapely.line_interpolate_point(ring, along_m)  # pyright: ignore[reportUnknownMemberType]
        places_m = shapely.get_coordinates(places)
        one, other = np.triu_indices(RING_SAMPLES, 1)
        chords_m = np.linalg.norm(places_m[one] - places_m[other], axis=1)
        part_m = along_m[other] - along_m[one]
        ratios = np.minimum(part_m, length_m - part_m) / np.maximum(chords_m, 1e-9)
        above = np.flatnonzero(ratios > least)
        above = above[np.argsort(-ratios[above])]
        chords = shapely.linestrings(places_m[np.stack([one[above], other[above]], axis=1)])
        # The path along the boundary is needed only if the chord has no length in free space.
        inside_m = shapely.length(shapely.intersection(chords, free))  # pyright: ignore[reportUnknownMemberType]
        outside = np.asarray(inside_m) <= SLACK * chords_m[above]
        if outside.any():
            least = float(ratios[above[outside.argmax()]])
    return least
