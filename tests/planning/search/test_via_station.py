"""Ways by a place: they come to it exactly, in time, and go on in all directions."""

from __future__ import annotations

import numpy as np
import pytest

from planopt.planning.search.fan_guesses import DETOURS, ONWARD, arc_turn, commands_via

START = np.array([3.0, 1.0])


def driven(turn, speed, longest):
    """In the open."""
    heading = np.cumsum(turn, axis=0)
    steps = longest * speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return START + np.cumsum(steps, axis=0).transpose(1, 0, 2)


@pytest.mark.parametrize("offset", [(5.0, -2.0), (-0.3, 0.2), (4.0, 0.0), (0.0, 0.0)])
def test_every_way_comes_to_the_place(offset):
    """At a step of its own; no step is too long; those that go on go apart, one waits."""
    place = START + offset
    commands = commands_via(START, place, 9, 2.0)
    assert commands is not None
    ways = driven(*commands, 2.0)
    away = np.linalg.norm(ways - place, axis=2)
    np.testing.assert_allclose(away.min(axis=1), 0.0, atol=1e-9)
    legs = np.diff(np.concatenate([np.tile(START, (len(ways), 1, 1)), ways], axis=1), axis=1)
    assert np.linalg.norm(legs, axis=2).max() <= 2.0 + 1e-9
    assert len(ways) == (1 + 2 * DETOURS) * (ONWARD + 1)
    assert (away[:, -1] < 1e-9).sum() == 1 + 2 * DETOURS


def test_out_of_reach_there_is_none():
    """Nor without steps left to go on, but the one straight there."""
    assert commands_via(START, START + [10.1, 0.0], 5, 2.0) is None
    commands = commands_via(START, START + [10.0, 0.0], 5, 2.0)
    assert commands is not None
    assert commands[0].shape == (5, 1)


@pytest.mark.parametrize(("chord", "steps"), [(3.0, 4), (0.0, 5), (1.0, 2), (4.0, 4)])
def test_arcs_have_their_chord(chord, steps):
    """Unit steps that turn evenly."""
    heading = arc_turn(chord, steps) * np.arange(steps)
    end = np.array([np.cos(heading).sum(), np.sin(heading).sum()])
    assert np.linalg.norm(end) == pytest.approx(chord, abs=1e-5)
