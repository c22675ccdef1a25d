"""What every plan of a problem must keep."""

from __future__ import annotations

from dataclasses import dataclass, field

from planopt.plain_values import make_plain, part_of
from planopt.problems.connectivity_rule import ConnectivityRule


@dataclass(frozen=True, kw_only=True)
class Constraints:
    """What every plan must keep.

    Attributes
    ----------
    p_min
        Least probability of connection, of what `rule` says; 0 asks for none.
    clearance_m
        Least distance of the whole swept path from every obstacle, and from every moving one.
    goal_radius_m
        The goal is reached within this distance of it.
    separation_m
        Least distance of any two robots at equal times, all the way; 0 asks for none.
    rule
        Where, when or over what the connection is asked for; at each step unless it says else.
    """

    p_min: float = 0.0
    clearance_m: float = 1.0
    goal_radius_m: float = 1.0
    separation_m: float = 0.0
    rule: ConnectivityRule = field(default_factory=ConnectivityRule)

    def __post_init__(self) -> None:
        make_plain(self)
        part_of("constraints", self.rule, ConnectivityRule)

    @property
    def asks_connection(self) -> bool:
        """Whether anything is asked of the connection."""
        return self.p_min > 0.0 or self.rule.kind.asks_without_p_min

    @property
    def step_p_min(self) -> float:
        """What is asked of single steps; 0 where p_min is of something else, or absent."""
        return self.p_min if self.rule.kind.of_steps else 0.0
