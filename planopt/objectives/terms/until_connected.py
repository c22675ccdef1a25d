"""The term ``until_connected``: expected distance until connected, subtracted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from planopt.objectives.terms.term import Steers, Term


@dataclass(frozen=True)
class UntilConnectedTerm(Term):
    """Expected distance until connected, a cost.

    Attributes
    ----------
    weight
        Factor in the sum of terms, per metre; the distance is subtracted.
    beyond_m
        Metres that the search is expected to go on for where the place that the robot is steered
        to is not connected; None: estimated from what is believed.
    """

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
    summary: ClassVar[str] = "Find connection after a short way."
    task: ClassVar[str | None] = "connect"

    @property
    def shares_places(self) -> bool:
        """A try at one place tells of the next."""
        return True

    @property
    def tries_connection(self) -> bool:
        """Places that were tried are not tried again."""
        return True

    @property
    def steers(self) -> Steers | None:
        """The robot is steered to a place to try."""
        return "connection"

    @property
    def calibration_fault(self) -> str | None:
        """First passages are of a normal law."""
        return "the distance until connected rests on the normal law of a whole path"
