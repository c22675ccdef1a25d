"""Which connectivity a plan must keep: at every step, at stated times, on average, and so on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from planopt.plain_values import make_plain

ParameterUncertainty = Literal["path_loss", "all"]
ConnectivityForm = Literal["each_step", "stated_times", "average", "joint", "outage", "data"]


@dataclass(frozen=True)
class ConnectivityRule:
    """What is asked of the connection along a path; a step counts by the place that it ends at.

    Attributes
    ----------
    connectivity
        ``each_step``: probability at least p_min at each step. ``stated_times``: only at the times
        stated. ``average``: on average over the run so far and the plan. ``joint``: that all steps
        of the plan are connected. ``outage``: steps below p_min in a row are no longer than
        stated. ``data``: the data delivered keep pace with the deadline, with probability p_min or,
        where that is 0, in expectation.
    connected_times_s
        Of ``stated_times``, from the start of the run.
    outage_max_m, outage_max_s
        Of ``outage``, one of them.
    data_mbit, deadline_s, rate_mbit_s
        Of ``data``: how much, until when, and the rate while connected.
    slack_max_db
        The rule may be missed by so many dB: it must hold were the threshold that much lower. 0 is
        hard. None: ``each_step`` and ``stated_times`` may be missed where no place within reach
        keeps them, others are hard.
    slack_price
        What a dB of slack costs, in the objective's unit.
    parameter_uncertainty
        ``path_loss``: predictions count that theta is estimated; ``all``: that xi, beta and omega
        are as well.
    """

    connectivity: ConnectivityForm = "each_step"
    connected_times_s: tuple[float, ...] = ()
    outage_max_m: float | None = None
    outage_max_s: float | None = None
    data_mbit: float | None = None
    deadline_s: float | None = None
    rate_mbit_s: float | None = None
    slack_max_db: float | None = None
    slack_price: float = 0.0
    parameter_uncertainty: ParameterUncertainty = "path_loss"

    def __post_init__(self) -> None:
        make_plain(self)

    @property
    def is_plain(self) -> bool:
        """Whether p_min is asked of each step where it is possible, and nothing else."""
        return self.connectivity == "each_step" and self.slack_max_db is None

    @property
    def by_step(self) -> bool:
        """Whether single steps are asked for, each by itself."""
        return self.connectivity in ("each_step", "stated_times")
