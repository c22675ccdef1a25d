"""Dynamic programme over pairs of cells for rewards that depend on the previous position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.objectives.upper_bounds import Field, PairedInformation

Array = Floats
Cells = Indices
Slices = tuple[slice, slice]


@dataclass(frozen=True, eq=False)
class PairedSteps:
    """Pairs of cells within one step, on a grid that contains the cells of all stages."""

    active: Sequence[Cells]  # Cells of each stage
    corner: Cells  # (2,) lower left cell of the grid
    shape: tuple[int, int]
    # For each offset, slices of earlier and later cells, and bounds of their moves and of what
    # the later reward loses
    pairs: Sequence[tuple[Slices, Slices, Array]]

    @classmethod
    def over(
        cls,
        paired: PairedInformation,
        active: Sequence[Cells],
        fields: Sequence[Field],
        side_m: float,
        longest_m: float,
        costs: tuple[float, float, float],
    ) -> PairedSteps:
        """Return a level's cell pairs; `costs` are per metre, per move, and standstill length."""
        cells = np.vstack(active)
        corner = cells.min(axis=0, initial=0)
        rows, columns = (cells.max(axis=0, initial=0) + 1 - corner).tolist()
        least, most, near = (np.full((rows, columns), 1.0) for _ in range(3))
        for own, field in zip(active, fields, strict=True):
            at = tuple((own - corner).T)
            least[at] = -field["minus_variance_db2"].most
            most[at] = field["variance_db2"].most
            near[at] = paired.nearest_m(field.discs)
        count = int(np.ceil(longest_m / side_m)) + 1
        pairs: list[tuple[Slices, Slices, Array]] = []
        for i in range(-count, count + 1):
            for j in range(-count, count + 1):
                away = side_m * float(np.hypot(max(abs(i) - 1, 0), max(abs(j) - 1, 0)))
                if away > longest_m or abs(i) >= rows or abs(j) >= columns:
                    continue
                far = min(longest_m, side_m * float(np.hypot(abs(i) + 1, abs(j) + 1)))
                before = _shifted(rows, -i), _shifted(columns, -j)
                after = _shifted(rows, i), _shifted(columns, j)
                nearest = np.minimum(near[before], near[after])
                lost = paired.lost(least[before], most[after], far, nearest)
                cost = costs[0] * away + (costs[1] if away > costs[2] else 0.0)
                pairs.append((before, after, -lost - cost))
        return cls(active, corner, (rows, columns), pairs)

    def best(self, stage: int, values: Array, *, ahead: bool) -> Array:
        """Return, for each cell, the largest sum of a pair's reward and its other cell's value.

        With `ahead`, values are those of the stage before `stage` and the result is for `stage`;
        otherwise the reverse.
        """
        known, wanted = self.active[stage - 1], self.active[stage]
        known, wanted = (known, wanted) if ahead else (wanted, known)
        grid, reached = np.full(self.shape, -np.inf), np.full(self.shape, -np.inf)
        grid[tuple((known - self.corner).T)] = values
        for before, after, gain in self.pairs:
            source, target = (before, after) if ahead else (after, before)
            np.maximum(reached[target], grid[source] + gain, out=reached[target])
        return reached[tuple((wanted - self.corner).T)]


def _shifted(size: int, by: int) -> slice:
    """Return the slice of indices below `size` that stay in range after subtracting `by`."""
    return slice(max(by, 0), size + min(by, 0))
