"""Term ``until_connected``: minus the expected distance until connected."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.objectives.path_derivatives import PathDerivatives
from planopt.objectives.terms.context import NearPath, Paths, TermContext
from planopt.objectives.terms.term import Steers, Term
from planopt.objectives.until_connected import (
    NOT_PROBED_DB,
    Search,
    charged_distance_derivatives,
    charged_distance_m,
    charged_distances_m,
    counted_legs_m,
    search_length_m,
)
from planopt.targets.rounding import Derivatives, rounded_length


@dataclass(frozen=True)
class UntilConnectedTerm(Term):
    """Expected distance until connected, counted as a cost."""

    beyond_m: Annotated[
        float | None,
        Field(
            ge=0,
            le=1e6,
            description="Metres that the search is expected to go on for where the place that the "
            "robot is steered to is not connected; by default estimated from what is believed.",
        ),
    ] = None

    kind: ClassVar[str] = "until_connected"
    summary: ClassVar[str] = "Regain contact after a short distance."
    task: ClassVar[str | None] = "connect"

    @property
    def steers(self) -> Steers | None:
        """Return ``connection``: the robot is steered to a position to probe."""
        return "connection"

    def search(self, at: TermContext) -> Search:
        """Return the search settings; the robot's current position is not a probe."""
        x, y = at.position_m
        return Search(
            (float(x), float(y)),
            at.thresholds_dbm,
            beyond_m=at.once((UntilConnectedTerm, "after", self), lambda: self._after_try_m(at)),
            step_m=at.step_length_m,
        )

    def _after_try_m(self, at: TermContext) -> float:
        """Return the expected search length beyond the end of the steered path, in metres."""
        # It is R - D of `search_length_m`. It depends on that path only, so it can be recomputed
        # from a saved plan.
        steered = at.steering
        if steered is None:
            return at.workspace_diagonal_m if self.beyond_m is None else self.beyond_m
        chance = np.array([at.chance(steered.end_m)])
        after = self.search_length_m(at, steered.rest_m[:1], chance) - steered.rest_m[0]
        # The cost is capped, because probabilities near a thousandth are unreliable.
        most_m = at.workspace_diagonal_m if self.beyond_m is None else np.inf
        return max(min(float(after[0]), most_m), 0.0)

    def search_length_m(
        self, at: TermContext, length_m: NDArray[np.float64], chance: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the expected search lengths for first probes at these distances; ``(k,)``."""
        # The length is R of `until_connected`, or D + (1 - P) `beyond_m`.
        if self.beyond_m is not None:
            return length_m + (1.0 - chance) * self.beyond_m
        return search_length_m(length_m, chance, at.decorrelation_m)

    def charged_beyond_m(self, at: TermContext, ends_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the cost-to-go of plans that end at `ends_m` (n, 2) without connection; (n,)."""
        after = np.full(len(ends_m), self.search(at).beyond_m)
        return after if at.steering is None else after + at.steering.distance_m(ends_m)

    def value(self, at: TermContext, path_m: NDArray[np.float64]) -> float:
        """Return minus the expected search length in metres along one path."""

        def charged_m() -> float:
            beyond = float(self.charged_beyond_m(at, path_m[-1:])[0])
            settings = replace(self.search(at), beyond_m=beyond)
            return charged_distance_m(at.stations, path_m, settings, at.probing.takes(path_m))

        return -at.once((UntilConnectedTerm, "charged", self, path_m.tobytes()), charged_m)

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return the values of many paths, by recursive filtering."""
        settings = self.search(paths.at)
        missing_db = np.where(paths.at.probing.takes(paths.paths_m), 0.0, NOT_PROBED_DB)
        powers = [
            (
                power.mean_db.reshape(paths.shape) - threshold - missing_db,
                station.moments().universal,
            )
            for power, station, threshold in zip(
                paths.each, paths.stations, settings.thresholds_dbm, strict=True
            )
        ]
        beyond = self.charged_beyond_m(paths.at, paths.paths_m[:, -1])
        legs = counted_legs_m(paths.legs_m, settings.step_m)
        return -charged_distances_m(powers, legs, beyond)

    def derivatives(self, path: NearPath) -> PathDerivatives:
        """Return the value and derivatives of one path, using the local channel."""
        search = self.search(path.at)
        found = charged_distance_derivatives(
            path.channels,
            path.places_m,
            search,
            path.rounding_m,
            _beyond(path, search),
            path.probed,
        )
        return PathDerivatives(-found.value, -found.gradient, -found.hessian)

    def stage_reward(
        self,
        at: TermContext,
        places_m: NDArray[np.float64],
        stage: int | NDArray[np.intp],
        chance: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return the expected distance saved if each position were the only probe."""
        return self.search(at).beyond_m * chance

    def largest_stage_reward(self, at: TermContext) -> float:
        """Return the distance saved by certain connection."""
        return self.search(at).beyond_m


def _beyond(path: NearPath, search: Search) -> Derivatives | None:
    """Return cost-to-go and derivatives w.r.t. the last position; None without steering."""
    steering = path.at.steering
    if path.ahead is None or steering is None:
        return None
    turn = path.ahead[-1:]
    leg = rounded_length(path.places_m[-1:] - steering.turns_m[turn], path.rounding_m)
    rest = leg.value + steering.rest_m[turn] + search.beyond_m
    return Derivatives(rest, leg.gradient, leg.hessian)
