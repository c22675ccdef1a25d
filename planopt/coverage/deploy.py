"""Target positions that drive a network to a deployment of lower cost than the nearest optimum."""

from typing import cast

import numpy as np
from scipy.optimize import linear_sum_assignment  # pyright: ignore[reportUnknownVariableType]

from planopt.arrays import Floats, Indices
from planopt.coverage.geodesic import Ground
from planopt.coverage.optima import STARTS, best_deployment


class Deployer:
    """Deployment search that assigns positions to the covering agents of a network."""

    def __init__(self, ground: Ground, generator: np.random.Generator) -> None:
        self._ground, self._generator = ground, generator
        self._agents: Indices = np.zeros(0, dtype=np.intp)  # Covering agents, ascending
        self._places = np.zeros((0, 2))  # Their targets

    def places_m(self, agents: Indices, here_m: Floats) -> Floats:
        """Return target positions (k, 2) for covering agents with ascending numbers (k,)."""
        if not np.array_equal(agents, self._agents):
            # After a change, the search starts from the old targets and newcomers' positions.
            first = here_m.copy()
            stays = np.isin(agents, self._agents)
            first[stays] = self._places[np.isin(self._agents, agents)]
            starts = 1 if stays.any() else STARTS
            found = best_deployment(
                self._ground, len(agents), starts, self._generator, first_m=first
            )
            away_m = self._ground.distances_m(here_m, found.places_m)
            _, order = cast("tuple[Indices, Indices]", linear_sum_assignment(away_m**2))
            self._agents, self._places = agents, found.places_m[order]
        return self._places
