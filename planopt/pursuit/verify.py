"""Verification of a logged pursuit against its problem, without code of the simulator.

Motions are reconstructed from the states at both ends of a step. A single integrator drives
straight; a unicycle turns on the spot and drives straight, or drives an arc, as fast as its limits
allow. Reports are compared with the rounds of the service, captures with distances along the steps.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import shapely

from planopt.arrays import Floats, Indices, Mask

PLACE_M, TIME_S = 1e-6, 1e-6  # Rounding tolerances of positions and times
ARC_PIECES = 16
"""Number of chords that approximate an arc, which turns by less than half a turn per step."""
CAPTURE_PIECES = 4  # Number of equal parts of a step on which captures are detected


@dataclass(frozen=True)
class Robot:
    """Start and limits of a pursuer or an evader."""

    name: str
    start_m: tuple[float, float]
    start_radius_m: float
    speed_max_m_s: float
    turn_rate_max_rad_s: float | None = None  # None for a single integrator


@dataclass(frozen=True)
class Service:
    """Snapshot service of a grid of motes, as in the table ``[network]``."""

    levels: int
    mote_spacing_m: float
    frame_s: float
    bits_per_axis: int
    hops_per_round: int
    rate_divisor: int
    endless: bool
    loss_probability: float = 0.0
    updates: str = "full"  # All rules deliver the same reports to pursuers
    # Detection errors; reports then do not name the evader
    detection: Mapping[str, float] | None = None

    @property
    def rounds_s(self) -> Floats:
        """Return the duration of a round of each level (L + 1,)."""
        return self.hops_per_round * self.frame_s * np.exp2(np.arange(self.levels + 1))

    @property
    def periods_s(self) -> Floats:
        """Return the time between the samples of each level (L + 1,)."""
        return self.rate_divisor * self.rounds_s

    def ended(self, times_s: Floats) -> Floats:
        """Return the index (k, L + 1) of each level's last round that ended by times (k,)."""
        return np.floor((times_s[:, None] - self.rounds_s) / self.periods_s + 1e-9)

    def reporting(self, seen: Indices, claim: tuple[float, Floats, float]) -> Mask:
        """Return a mask (L + 1,) of the levels whose report on motes `seen` matches the claim."""
        fine = np.maximum(0, np.arange(self.levels + 1) - self.bits_per_axis)
        side_m = self.mote_spacing_m * 2.0**fine
        report_m = ((seen >> fine[:, None]) + 0.5) * side_m[:, None]
        agrees = np.abs(report_m - claim[1]).max(axis=1) <= PLACE_M
        return agrees & (np.abs(math.sqrt(0.5) * side_m - claim[2]) <= PLACE_M)


@dataclass(frozen=True, eq=False)
class PursuitData:
    """Problem with which a logged pursuit must comply."""

    pursuers: tuple[Robot, ...]
    evaders: tuple[Robot, ...]
    service: Service
    capture_radius_m: float
    step_s: float
    max_steps: int
    planner: str
    bounds_m: tuple[float, float, float, float] | None
    obstacles: tuple[shapely.Polygon, ...]
    clearance_m: float


@dataclass(frozen=True, eq=False)
class Reports:
    """Reports that pursuers used, in the order of first use."""

    pursuer: Indices  # (k,) indices of pursuer and evader
    evader: Indices
    time_s: Floats  # (k,) time of receipt
    sampled_s: Floats  # (k,) sample time
    reported_m: Floats  # (k, 2)
    error_m: Floats  # (k,) claimed error bound

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Return the pair (pursuer, evader) of each report."""
        pursuers: list[int] = self.pursuer.tolist()
        return list(zip(pursuers, self.evader.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class PursuitLog:
    """Log of a pursuit with n steps."""

    times_s: Floats  # (n + 1,)
    states: tuple[Floats, ...]  # (n + 1, 2) per pursuer, or (n + 1, 3) with the heading
    aims_m: Floats  # (p, n, 2) point that each pursuer drives to
    chased: Indices  # (p, n) evader that each pursuer chases
    evaders_m: Floats  # (e, n + 1, 2)
    capture_s: Floats  # (e,) infinite if never captured
    captors: Indices  # (e,) -1 if never captured
    reports: Reports

    def evader_at(self, evader: int, times_s: Floats) -> Floats:
        """Return the evader's positions (k, 2) at times; the start before the first time."""
        return _interpolated(times_s, self.times_s, self.evaders_m[evader])

    def seen(self, service: Service, evader: int, rounds: Floats) -> Indices:
        """Return column and row (L + 1, 2) of the evader's mote at each level's sample time."""
        return _mote(service, self.evader_at(evader, rounds * service.periods_s))


@dataclass(frozen=True)
class Violation:
    """Reason to reject a logged pursuit."""

    # time, start, motion, speed, aim, bounds, clearance, report, order, chase, capture, end,
    # guarantee or stages
    kind: str
    text: str


def verify_pursuit(data: PursuitData, log: PursuitLog) -> list[Violation]:
    """Return all violations of a logged pursuit."""
    numbers = (log.times_s, *log.states, log.aims_m, log.evaders_m)
    if not all(np.isfinite(each).all() for each in numbers):
        return [Violation("motion", "a position, a heading, an aim or a time is not finite")]
    steps = np.arange(len(log.times_s))
    if np.abs(log.times_s - data.step_s * steps).max() > TIME_S:
        return [Violation("time", "steps are not pursuit.step_s apart")]
    found: list[Violation] = []
    drives = tuple(
        _reconstructed(robot, states, aims_m, data.step_s, found)
        for robot, states, aims_m in zip(data.pursuers, log.states, log.aims_m, strict=True)
    )
    for robot, places_m in zip(data.evaders, log.evaders_m, strict=True):
        over_m = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
        over_m -= robot.speed_max_m_s * data.step_s
        _worst(found, "speed", robot.name, "is too fast", over_m)
    own_m = (
        np.concatenate([states[:1, :2], each.places_m.reshape(-1, 2)])
        for states, each in zip(log.states, drives, strict=True)
    )
    paths_m = (*own_m, *log.evaders_m)
    for robot, places_m in zip((*data.pursuers, *data.evaders), paths_m, strict=True):
        found += _position_faults(data, robot, places_m)
    found += _report_faults(data, log)
    found += _aim_faults(data, log)
    found += _capture_faults(data, log, drives)
    return found


@dataclass(frozen=True, eq=False)
class Drives:
    """Motion of a pursuer in each step, as straight segments between k knots."""

    shares: Floats  # (n, k) fraction of the step, ascending from 0 to 1
    places_m: Floats  # (n, k, 2)
    bent: Mask  # (n,) whether the step has a kink or an arc


def _reconstructed(
    robot: Robot, states: Floats, aims_m: Floats, step_s: float, found: list[Violation]
) -> Drives:
    """Return the reconstructed motion between logged states; add violations to `found`."""
    here, there = states[:-1, :2], states[1:, :2]
    move = there - here
    length = np.linalg.norm(move, axis=1)
    speed = robot.speed_max_m_s
    turn = spot_s = np.zeros(len(move))
    arc = np.zeros(len(move), dtype=np.bool_)
    drive_s = length / speed
    away_m = np.linalg.norm(aims_m - here, axis=1)
    lines = shapely.linestrings(np.stack([here, aims_m], axis=1))
    off_line_m = np.asarray(shapely.distance(lines, shapely.points(there)), dtype=np.float64)  # pyright: ignore[reportUnknownMemberType]
    bearing = off_circle_m = np.zeros(len(move))
    if robot.turn_rate_max_rad_s is not None:
        rate, heading = robot.turn_rate_max_rad_s, states[:, 2]
        turn = _wrapped(np.diff(heading))
        # The direction of an arc's chord is the mean of the headings at its ends.
        on_spot, along = _is_along(heading[1:], move), _is_along(heading[:-1] + 0.5 * turn, move)
        spot_s = np.abs(turn) / rate
        on_time = on_spot & (spot_s + drive_s <= step_s + TIME_S)
        bearing = np.arctan2(*(aims_m - here).T[::-1]) - heading[:-1]
        bearing = np.where(away_m > PLACE_M, _wrapped(bearing), 0.0)
        # On an arc, the aim must lie on the circle. Wide arcs resemble a turn and a straight drive.
        sine = np.sin(bearing)
        circle_m = away_m * np.divide(np.sin(0.5 * turn), sine, out=0.0 * sine, where=sine != 0.0)
        off_circle_m = np.abs(circle_m - length)
        arc = along & (~on_time | (off_circle_m < off_line_m))
        aside_m = np.where(on_spot | along, 0.0, length)
        _worst(found, "motion", robot.name, "moves sideways", aside_m)
        arc_s = np.maximum(length / np.sinc(0.5 * turn / np.pi) / speed, spot_s)
        drive_s, spot_s = np.where(arc, arc_s, drive_s), np.where(arc, 0.0, spot_s)
    over_s = spot_s + drive_s - step_s
    _worst(found, "speed", robot.name, "is too fast", speed * over_s)
    missed_m = off_line_m
    if robot.turn_rate_max_rad_s is not None:
        # A turn on the spot must not overshoot.
        unturned = np.abs(_wrapped(bearing - turn)) + np.abs(turn) - np.abs(bearing)
        missed_m = np.where(length > PLACE_M, off_line_m, unturned * speed * step_s)
        missed_m = np.where(arc, off_circle_m, missed_m)
    early = (over_s < -TIME_S) & (np.linalg.norm(aims_m - there, axis=1) > PLACE_M)
    missed_m = np.where(early, np.maximum(missed_m, -speed * over_s), missed_m)
    _worst(found, "aim", robot.name, "does not drive to its aim, off by", missed_m)
    return _drives(here, states[:-1, 2:], move, turn, arc, spot_s / step_s, drive_s / step_s)


def _drives(
    here: Floats,
    heading: Floats,
    move: Floats,
    turn: Floats,
    arc: Mask,
    spot: Floats,
    drive: Floats,
) -> Drives:
    """Return steps that rest for a fraction `spot`, drive for a fraction `drive`, then rest."""
    part = np.linspace(0.0, 1.0, ARC_PIECES + 1 if arc.any() else 2)
    driven = np.broadcast_to(part[:, None], (len(here), len(part), 1)) * move[:, None]
    if arc.any():
        half = 0.5 * turn[arc]
        radius = np.linalg.norm(move[arc], axis=1) / np.where(half != 0.0, 2.0 * np.sin(half), 1.0)
        ahead = half[:, None] * part
        chord = 2.0 * radius[:, None] * np.sin(ahead)
        angle = heading[arc] + ahead
        driven = driven.copy()
        curved = np.stack([chord * np.cos(angle), chord * np.sin(angle)], axis=-1)
        driven[arc] = np.where(half[:, None, None] != 0.0, curved, driven[arc])
    begin, end = np.minimum(spot, 1.0), np.minimum(spot + drive, 1.0)
    shares = begin[:, None] + part * (end - begin)[:, None]
    ends = np.zeros((len(here), 1)), np.ones((len(here), 1))
    places = here[:, None] + driven
    return Drives(
        np.hstack([ends[0], shares, ends[1]]),
        np.concatenate([here[:, None], places, places[:, -1:]], axis=1),
        arc | ((begin > 0.0) | (end < 1.0)),
    )


def _wrapped(angle: Floats) -> Floats:
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi


def _is_along(heading: Floats, move: Floats) -> Mask:
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    across = move[:, 0] * ahead[:, 1] - move[:, 1] * ahead[:, 0]
    return (np.abs(across) <= PLACE_M) & ((move * ahead).sum(axis=1) >= -PLACE_M)


def _worst(found: list[Violation], kind: str, name: str, words: str, off_m: Floats) -> None:
    """Add a violation for the step of the largest deviation if this exceeds the tolerance."""
    if len(off_m) and not off_m.max() <= PLACE_M:
        step = int(off_m.argmax())
        found.append(Violation(kind, f"{name} {words} {off_m[step]:.4g} m at step {step}"))


def _position_faults(data: PursuitData, robot: Robot, places_m: Floats) -> Iterator[Violation]:
    """Yield violations: wrong start, positions out of bounds, too little obstacle clearance."""
    if math.dist(places_m[0], robot.start_m) > robot.start_radius_m + PLACE_M:
        yield Violation("start", f"{robot.name} does not start at start_m")
    if data.bounds_m is not None:
        low, high = np.array(data.bounds_m[:2]), np.array(data.bounds_m[2:])
        if ((places_m < low - PLACE_M) | (places_m > high + PLACE_M)).any():
            yield Violation("bounds", f"{robot.name} leaves world.bounds_m")
    if data.obstacles:
        path = shapely.LineString(places_m) if len(places_m) > 1 else shapely.Point(places_m[0])
        nearest_m = min(path.distance(each) for each in data.obstacles)
        if nearest_m < data.clearance_m - PLACE_M:
            yield Violation(
                "clearance",
                f"{robot.name} comes within {nearest_m:.4g} m of an obstacle, "
                f"pursuit.clearance_m is {data.clearance_m:g}",
            )


def _report_faults(data: PursuitData, log: PursuitLog) -> Iterator[Violation]:
    """Yield violations: impossible reports, and first uses that break rule R."""
    service, reports = data.service, log.reports
    if not len(reports.time_s):
        return
    step = np.abs(log.times_s[:, None] - reports.time_s).argmin(axis=0)
    if np.abs(log.times_s[step] - reports.time_s).max() > TIME_S:
        yield Violation("report", "a report is received at no step of the run")
        return
    held: dict[tuple[int, int], tuple[float, float]] = {}
    for row, (pursuer, evader) in enumerate(reports.pairs):
        who = f"the report {row} of {data.evaders[evader].name} to {data.pursuers[pursuer].name}"
        claim = reports.sampled_s[row], reports.reported_m[row], reports.error_m[row]
        number = np.rint(claim[0] / service.periods_s)
        # A pursuer that associates reports keeps those that it received earlier elsewhere.
        used = int(step[row])
        steps = np.arange(used + 1) if service.detection else np.array([used])
        ended = service.ended(log.times_s[steps])
        motes = _mote(service, log.states[pursuer][steps, :2])
        others = range(len(data.evaders)) if service.detection else [evader]
        seen = [log.seen(service, each, number) for each in others]
        if service.detection and service.detection["false_alarms"] > 0.0:
            seen.append(np.tile(_mote(service, claim[1]), (service.levels + 1, 1)))
        heard = [((ended == number) & _near(motes, each)).any(axis=0) for each in seen]
        claims = [service.reporting(each, claim) for each in seen]
        agrees = np.any(np.logical_and(heard, claims), axis=0)
        agrees &= np.abs(number * service.periods_s - claim[0]) <= TIME_S
        if not agrees.any():
            yield Violation("report", f"{who}: no mote could have given it")
        elif service.loss_probability == 0.0 and service.detection is None:
            shows = _near(motes, log.seen(service, evader, ended[0]))[0]
            if not agrees[shows.argmax()]:
                text = f"{who}: a finer level shows the evader, and none is lost"
                yield Violation("report", text)
        last_s, last_m = held.get((pursuer, evader), (-math.inf, math.inf))
        now_s, now_m = float(reports.sampled_s[row]), float(reports.error_m[row])
        if now_s < last_s - TIME_S or (now_s < last_s + TIME_S and now_m >= last_m):
            yield Violation("order", f"{who}: it replaces a fresher one")
        held[pursuer, evader] = now_s, now_m


def _mote(service: Service, places_m: Floats) -> Indices:
    """Return column and row of the mote whose square contains each position (..., 2)."""
    found = np.floor(places_m / service.mote_spacing_m).astype(np.int64)
    return found if service.endless else np.clip(found, 0, 2**service.levels - 1)


def _near(motes: Indices, seen: Indices) -> Mask:
    """Return a mask (k, L + 1) of levels at which cells of `motes` and `seen` are neighbours."""
    level = np.arange(len(seen))[:, None]
    apart = (motes[:, None] >> level) - (seen >> level)
    return np.asarray(np.abs(apart).max(axis=-1) <= 1, np.bool_)


def _aim_faults(data: PursuitData, log: PursuitLog) -> Iterator[Violation]:
    """Yield violations: aims that are neither the last report nor the pursuer's position."""
    # Among obstacles aims are path vertices, and a predicting pursuer chooses its own.
    if data.obstacles or data.planner not in ("drive", "retarget"):
        return
    bounds_m = data.bounds_m or (-math.inf, -math.inf, math.inf, math.inf)
    reports = log.reports
    for pursuer, robot in enumerate(data.pursuers):
        off_m = np.linalg.norm(log.aims_m[pursuer] - log.states[pursuer][:-1, :2], axis=1)
        for evader in range(len(data.evaders)):
            own = (reports.pursuer == pursuer) & (reports.evader == evader)
            chases = np.flatnonzero(log.chased[pursuer] == evader)
            last = np.searchsorted(reports.time_s[own], log.times_s[chases] + TIME_S) - 1
            chases, last = chases[last >= 0], last[last >= 0]
            aims_m = np.clip(reports.reported_m[own][last], bounds_m[:2], bounds_m[2:])
            to_aim_m = np.linalg.norm(log.aims_m[pursuer][chases] - aims_m, axis=1)
            off_m[chases] = np.minimum(off_m[chases], to_aim_m)
        if len(off_m) and off_m.max() > PLACE_M:
            step = int(off_m.argmax())
            yield Violation("aim", f"{robot.name} aims at no reported position at step {step}")


def _capture_faults(
    data: PursuitData, log: PursuitLog, drives: tuple[Drives, ...]
) -> Iterator[Violation]:
    """Yield violations: wrong captures, chases of captured evaders, wrong end of the run."""
    steps, radius_m = len(log.times_s) - 1, data.capture_radius_m
    for pursuer, robot in enumerate(data.pursuers):
        if steps and not np.isin(log.chased[pursuer], np.arange(len(data.evaders))).all():
            yield Violation("chase", f"{robot.name} chases no evader")
        elif steps and (log.capture_s[log.chased[pursuer]] < log.times_s[:-1] - TIME_S).any():
            yield Violation("chase", f"{robot.name} chases an evader that is captured")
    last_s = float(log.capture_s.max())
    if math.isfinite(last_s) and last_s < log.times_s[-1] - data.step_s - TIME_S:
        yield Violation("end", "the run goes on after the last capture")
    if math.isinf(last_s) and steps != data.max_steps:
        yield Violation("end", f"the run ends after {steps} steps with an evader free")
    for evader, robot in enumerate(data.evaders):
        caught_s, captor = float(log.capture_s[evader]), int(log.captors[evader])
        if math.isfinite(caught_s) != (captor >= 0) or captor >= len(data.pursuers):
            yield Violation("capture", f"{robot.name} is captured without a pursuer or a time")
            continue
        if not 0.0 <= caught_s <= log.times_s[-1] + TIME_S and math.isfinite(caught_s):
            yield Violation("capture", f"{robot.name} is captured after the end")
            continue
        # Step of the capture, and fraction of this step until the capture.
        step, share = steps, 0.0
        if captor >= 0:
            step = max(0, min(math.ceil(caught_s / data.step_s - 1e-9), steps) - 1)
            share = caught_s / data.step_s - step
        places_m = log.evaders_m[evader]
        if step < steps and np.ptp(places_m[step + 1 :], axis=0).max() > PLACE_M:
            yield Violation("capture", f"{robot.name} moves after it is captured")
        for pursuer, each in enumerate(drives):
            # Captures are detected on chords, whose error at a kink is at most a quarter of the
            # distance driven in a part.
            chord_m = 0.25 * data.pursuers[pursuer].speed_max_m_s * data.step_s / CAPTURE_PIECES
            slack_m = PLACE_M + chord_m * each.bent
            places, moves = places_m[:step, None], np.diff(places_m[: step + 1], axis=0)[:, None]
            apart_m = each.places_m[:step] - places - each.shares[:step, :, None] * moves
            least_m = _segments_from_origin_m(apart_m[:, :-1], apart_m[:, 1:]).min(axis=1)
            early = np.flatnonzero(least_m < radius_m - slack_m[:step])
            if len(early):
                when_s = log.times_s[early[0]]
                yield Violation(
                    "capture",
                    f"{robot.name} is within the capture radius at {when_s:.4g} s "
                    "without being captured",
                )
                break
            if step >= steps:
                continue
            knots = np.minimum(each.shares[step], share)
            own_m = _interpolated(knots, each.shares[step], each.places_m[step])
            along = (knots / max(share, 1e-12))[:, None]
            apart_m = own_m - places_m[step] - along * (places_m[step + 1] - places_m[step])
            before_m = float(_segments_from_origin_m(apart_m[:-1], apart_m[1:]).min())
            end_m = float(np.linalg.norm(apart_m[-1]))
            if before_m < radius_m - slack_m[step] and before_m < end_m - PLACE_M:
                yield Violation("capture", f"{robot.name} is captured later than it is reached")
                break
            if pursuer == captor and end_m > radius_m + slack_m[step]:
                yield Violation(
                    "capture", f"{robot.name} is {end_m:.4g} m away from its captor when captured"
                )


def _interpolated(at: Floats, knots: Floats, places_m: Floats) -> Floats:
    """Return the positions (m, 2) at `at`, interpolated between the positions at `knots` (k,)."""
    x, y = places_m[:, 0], places_m[:, 1]
    return np.stack([np.interp(at, knots, x), np.interp(at, knots, y)], axis=1)


def _segments_from_origin_m(starts: Floats, ends: Floats) -> Floats:
    """Return the distance (...,) of each segment from the origin."""
    along = ends - starts
    square = (along * along).sum(axis=-1)
    nearest = np.clip(-(starts * along).sum(axis=-1) / np.maximum(square, 1e-300), 0.0, 1.0)
    return np.linalg.norm(starts + nearest[..., None] * along, axis=-1)
