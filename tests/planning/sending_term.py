"""A term of one's own that adds up over steps, with its derivatives written out."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planopt.arrays import Derivatives
from planopt.extend import Term

NEPERS_PER_DB = np.log(10.0) / 10.0


@dataclass(frozen=True)
class SendingTerm(Term):
    """Expected transmit power that makes up for the attenuation, a cost: exp(a^2 s^2 / 2 - a m)."""

    kind: ClassVar[str] = "sending"

    @property
    def structure(self):
        return "stagewise"

    def value(self, at, path_m):
        """Return minus the power of all steps."""
        power = at.power(path_m)
        return -float(_needed(power.mean_db, power.deviation_db).sum())

    def values(self, paths):
        found = _needed(paths.power.mean_db, paths.power.deviation_db)
        return -found.reshape(paths.shape).sum(axis=1)

    def derivatives(self, path):
        """Return minus the power of each step, with gradient and Hessian by its place."""
        mean, deviation = path.stage_power
        a, sigma = NEPERS_PER_DB, deviation.value[:, None]
        needed = -_needed(mean.value, deviation.value)
        slope = a * a * sigma * deviation.gradient - a * mean.gradient
        bend = a * a * sigma * deviation.hessian - a * mean.hessian
        for first, scale in ((slope, 1.0), (deviation.gradient, a * a)):
            bend = bend + scale * first[:, [0, 0, 1]] * first[:, [0, 1, 1]]
        return Derivatives(needed, needed[:, None] * slope, needed[:, None] * bend)

    def node_reward(self, at, nodes):
        """Return minus the power at each node."""
        return -_needed(nodes.stations[0].mean_db, nodes.stations[0].deviation_db)


def _needed(mean_db, deviation_db):
    scaled = -NEPERS_PER_DB * (mean_db + 80.0) + 0.5 * (NEPERS_PER_DB * deviation_db) ** 2
    return 1e-3 * np.exp(scaled)
