"""Which moves of a lattice come too near to what moves, stage by stage, near it only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.tolerances import CLEARANCE_PAD_M
from planopt.world.lattice import MOVES, Lattice
from planopt.world.lattice_moves import LONGEST_MOVE
from planopt.world.moving_discs import MovingDiscs, passing_gaps_m


def first_steps_apart(
    discs: MovingDiscs, position_m: NDArray[np.float64], ends_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether first steps from a place (2,) to `ends_m` (n, 2) keep from all that moves; (n,).

    From a place that is nearer than planners keep, they may lead away.
    """
    return steps_apart(discs, 0, np.broadcast_to(position_m, ends_m.shape), ends_m)


def steps_apart(
    discs: MovingDiscs, step: int, starts_m: NDArray[np.float64], ends_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether straight ways (..., 2) during one step, 0 the first, keep from all that moves; (...).

    A way that begins nearer than planners keep may lead away.
    """
    if not len(discs):
        return np.ones(starts_m.shape[:-1], dtype=np.bool_)
    begin = discs.centres_m[:, step].reshape(-1, *([1] * (starts_m.ndim - 1)), 2)
    apart = discs.apart_m[:, step].reshape(begin.shape[:-1])
    here = np.linalg.norm(starts_m - begin, axis=-1) - apart
    wanted = np.minimum(CLEARANCE_PAD_M, here) if step == 0 else CLEARANCE_PAD_M
    return np.asarray((passing_gaps_m(discs, step, starts_m, ends_m) >= wanted).all(axis=0))


class MovingMoves:
    """The moves of a lattice beside what moves.

    Parameters
    ----------
    lattice
        Whose moves.
    discs
        What moves.
    """

    def __init__(self, lattice: Lattice, discs: MovingDiscs) -> None:
        self._lattice = lattice
        self._discs = discs

    def __len__(self) -> int:
        """How many discs there are."""
        return len(self._discs)

    def hindered(
        self, step: int, rows: slice, columns: slice
    ) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
        """Nodes of a window that some move in one step does not lead to, and which moves these are.

        Parameters
        ----------
        step
            0 is the first of the horizon.
        rows, columns
            The window, in the lattice.

        Returns
        -------
        (n,), (n,), (21, n) arrays
            Rows, columns, and whether each move to the node comes too near.
        """
        lattice, discs = self._lattice, self._discs
        places = [
            float(lattice.origin_m[axis])
            + lattice.spacing_m * np.arange(int(part.start), int(part.stop), dtype=np.float64)
            for axis, part in ((1, rows), (0, columns))
        ]
        y, x = places[0][:, None], places[1]
        near = np.zeros((len(y), len(x)), dtype=np.bool_)
        centres, before = discs.centres_m[:, step + 1], discs.centres_m[:, step]
        # No way during a step is longer than this, seen from the disc.
        longest = LONGEST_MOVE * lattice.spacing_m + np.linalg.norm(centres - before, axis=1)
        reach = discs.apart_m[:, step] + CLEARANCE_PAD_M + longest
        for centre, radius in zip(centres, reach, strict=True):
            near |= (y - centre[1]) ** 2 + (x - centre[0]) ** 2 <= radius**2
        found_rows, found_columns = np.nonzero(near)
        found_rows, found_columns = found_rows + rows.start, found_columns + columns.start
        blocked = self.blocked(step, found_rows, found_columns)
        some = blocked.any(axis=0)
        return found_rows[some], found_columns[some], blocked[:, some]

    def blocked(
        self, step: int, rows: NDArray[np.intp], columns: NDArray[np.intp]
    ) -> NDArray[np.bool_]:
        """Whether each move to nodes (n,) in one step comes too near; ``(21, n)``."""
        lattice = self._lattice
        ends = lattice.origin_m + lattice.spacing_m * np.stack([columns, rows], axis=-1)
        starts = ends - lattice.spacing_m * MOVES[:, None]
        ends = np.broadcast_to(ends, starts.shape)
        return ~steps_apart(self._discs, step, starts, ends)
