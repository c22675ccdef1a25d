"""Places to locate an event from: Fisher information, the Cramer-Rao bound, and the ring.

A measurement tells of the event along the line to it, in proportion to the squared slope of the
signal. At the event itself the slope is zero: an agent that has arrived there learns nothing more.
"""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment  # pyright: ignore[reportUnknownVariableType]

from planopt.coverage.localisation.sensor import EventSensor
from planopt.coverage.region import positive
from planopt.errors import InputError

LOOSE = 0.02
"""Bodies that crowd around an event keep this share of their radius more apart than they must."""


def fisher_information(
    sensor: EventSensor,
    positions_m: NDArray[np.float64],  # (k, 2) where agents measure
    event_m: NDArray[np.float64],  # (2,) where the event is
    counts: NDArray[np.float64] | None = None,  # (k,) how often they measure there; once if None
) -> NDArray[np.float64]:
    """Return what measurements tell of an event of known strength, ``sum g^2 u u' / sigma^2``."""
    offset = positions_m - event_m
    distance = np.linalg.norm(offset, axis=1)
    unit = offset / np.where(distance > 0.0, distance, 1.0)[:, None]
    gain = sensor.gain(distance) / sensor.noise_std
    weight = gain**2 if counts is None else counts * gain**2
    return (unit * weight[:, None]).T @ unit


def cramer_rao_m2(information: NDArray[np.float64]) -> float:
    """Return the least mean squared distance error of unbiased estimates, trace of the inverse.

    Infinite if the information ``(2, 2)`` is singular.
    """
    determinant = float(np.linalg.det(information))
    trace = float(np.trace(information))
    if not determinant > 1e-14 * trace**2:
        return float("inf")
    return trace / determinant


def ring_angles(count: int) -> NDArray[np.float64]:
    """Return angles ``(count,)`` at which agents tell most of an event, in rad.

    Equal angles, for which the information is the same in all directions; two agents stand 90
    degrees apart, since opposite each other they would tell of one direction only.
    """
    if count < 1:
        raise InputError(f"{count} agents", key="agents")
    turn = 0.5 * np.pi if count == 2 else 2.0 * np.pi / count
    return turn * np.arange(count, dtype=np.float64)


def ring_places(
    agents_m: NDArray[np.float64], event_m: NDArray[np.float64], radius_m: float
) -> NDArray[np.float64]:
    """Return a place on the ring for each agent, in their order around the event.

    The ring is turned so that the sum of squared angles that agents have to turn is least; they do
    not cross each other's way.
    """
    # Shapes: agents_m (k, 2); event_m (2,).
    positive(radius_m, "radius_m")
    offset = agents_m - event_m
    angle = np.arctan2(offset[:, 1], offset[:, 0])
    order = np.argsort(angle, kind="stable")
    slots = ring_angles(len(agents_m))
    best, least = slots, np.inf
    for first in range(len(slots)):
        # The gap of an uneven ring (two agents) may lie between any of them.
        turned = np.roll(slots, first) + np.where(np.arange(len(slots)) < first, -2.0 * np.pi, 0.0)
        shift = float((angle[order] - turned).mean())
        cost = float(((angle[order] - turned - shift) ** 2).sum())
        if cost < least - 1e-12:
            best, least = turned + shift, cost
    at = np.empty(len(slots))
    at[order] = best
    return event_m + radius_m * np.stack((np.cos(at), np.sin(at)), axis=1)


def packed_places(
    agents_m: NDArray[np.float64], event_m: NDArray[np.float64], body_radius_m: float
) -> NDArray[np.float64]:
    """Return a place for each agent of a team of bodies that crowds around an event.

    Places are those of a hexagonal lattice that are nearest to the event, which is at a place, in
    the middle of two or of three, whichever leaves the farthest one nearest. The sum of squared
    distances from agents to places is least, so that agents that block each other swap places.
    """
    # Shapes: agents_m (k, 2); event_m (2,).
    count, side = len(agents_m), 2.0 * (1.0 + LOOSE) * positive(body_radius_m, "body_radius_m")
    shells = np.arange(-count, count + 1)
    steps = np.stack(np.meshgrid(shells, shells), axis=-1).reshape(-1, 2)
    lattice = side * steps @ np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
    middles = side * np.array([[0.0, 0.0], [0.5, 0.0], [0.5, np.sqrt(0.75) / 3.0]])
    away = np.linalg.norm(lattice - middles[:, None], axis=2)
    order = np.argsort(away, axis=1, kind="stable")[:, :count]
    kept = np.take_along_axis(away, order, axis=1)
    best = min(range(3), key=lambda one: (round(float(kept[one, -1] / side), 9), kept[one].sum()))
    places = event_m + lattice[order[best]] - middles[best]
    squares = ((agents_m[:, None] - places) ** 2).sum(axis=2)
    slots = cast("NDArray[np.intp]", linear_sum_assignment(squares)[1])
    return places[slots]


def event_places(
    agents_m: NDArray[np.float64],
    event_m: NDArray[np.float64],
    stand_off_m: float | None,
    body_radius_m: float,
) -> NDArray[np.float64]:
    """Return where agents ``(k, 2)`` that respond to an event should stand.

    They stand on a ring around it or, if none is asked for, at it; bodies crowd around it.
    """
    if stand_off_m is not None:
        return ring_places(agents_m, event_m, stand_off_m)
    if body_radius_m > 0.0:
        return packed_places(agents_m, event_m, body_radius_m)
    return np.repeat(event_m[None], len(agents_m), axis=0)


def fused(
    positions_m: NDArray[np.float64], informations: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Join independent estimates of one place, each weighted by its information.

    The sums in it can be averaged over a network, so that every agent gets the joint estimate.
    """
    # Shapes: positions_m (k, 2); informations (k, 2, 2); returns (2,).
    total = np.asarray(informations.sum(axis=0), dtype=np.float64)
    if not np.isfinite(cramer_rao_m2(total)):
        raise InputError("the estimates leave a direction open", key="informations")
    pull = (informations @ positions_m[:, :, None])[:, :, 0].sum(axis=0)
    return np.asarray(np.linalg.solve(total, pull), dtype=np.float64), total
