"""Tables of how many agents an event asks for; each kind makes its demand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from planopt.coverage.assignment import (
    Demand,
    accuracy_demand,
    capped_demand,
    table_demand,
    trade_off_demand,
)
from planopt.coverage.localisation import EventSensor
from planopt.errors import InputError
from planopt.keys import SMALLEST, Metres, Table


@dataclass(frozen=True, eq=False)
class DemandContext:
    """The sensor, covered area and number of agents that demands may depend on."""

    sensor: EventSensor
    area_m2: float
    agents: int


class NumberTable(Table):
    """A fixed number of agents."""

    kind: Literal["number"]
    agents: int = Field(ge=0, le=20_000, description="How many.")

    def demand(self, scene: DemandContext) -> Demand:
        """Return the demand."""
        if self.agents > scene.agents:
            raise InputError(
                f"asks for {self.agents} agents, there are {scene.agents}",
                key="agents",
                remedy="give more agents, or ask for fewer",
            )
        return lambda agents: min(self.agents, agents)


class StepTable(Table):
    """Steps of a demand: from so many agents on, so many respond."""

    at_least: int = Field(ge=0, le=20_000, description="From so many agents on.")
    respond: int = Field(ge=0, le=20_000, description="So many respond.")


class TableDemandTable(Table):
    """The demand by the number of agents, from a table."""

    kind: Literal["table"]
    steps: list[StepTable] = Field(min_length=1, description="Entries of the table.")

    def demand(self, scene: DemandContext) -> Demand:
        """Return the demand."""
        for number, step in enumerate(self.steps):
            if step.respond > step.at_least:
                raise InputError(
                    f"asks for {step.respond} of {step.at_least} agents",
                    key=f"steps[{number}].respond",
                    remedy="ask for at most at_least",
                )
        return table_demand({each.at_least: each.respond for each in self.steps})


class CapTable(Table):
    """A share of the agents, at most a number, so that enough remain."""

    kind: Literal["cap"]
    share: float = Field(ge=0, le=1, description="Share of all agents, rounded up.")
    most: int = Field(ge=0, le=20_000, description="At most so many.")
    remaining: int = Field(default=1, ge=0, le=20_000, description="So many stay with coverage.")

    def demand(self, scene: DemandContext) -> Demand:
        """Return the demand."""
        if self.remaining >= scene.agents:
            raise InputError(
                f"keeps {self.remaining} agents from answering, there are {scene.agents}",
                key="remaining",
                remedy="give more agents, or keep fewer",
            )
        return capped_demand(self.share, self.most, self.remaining)


class AccuracyTable(Table):
    """As many agents as locate the event well enough."""

    kind: Literal["accuracy"]
    accuracy_m: Metres = Field(ge=SMALLEST, description="Root mean squared error in metres.")
    measurements: int = Field(default=1, ge=1, le=10**6, description="Of each agent.")

    def demand(self, scene: DemandContext) -> Demand:
        """Return the demand."""
        found = accuracy_demand(scene.sensor, self.accuracy_m, self.measurements)
        needed = found(10**9)
        if needed > scene.agents:
            raise InputError(
                f"needs {needed} agents, there are {scene.agents}",
                key="accuracy_m",
                remedy="give more agents, or ask for less",
            )
        return found


class TradeOffTable(Table):
    """As many agents as balance coverage against localisation."""

    kind: Literal["trade_off"]
    localisation_m2: float = Field(ge=SMALLEST, le=1e12, description="Error with one agent.")
    coverage_weight: float = Field(default=1.0, ge=SMALLEST, le=1e12, description="Of H.")
    localisation_weight: float = Field(ge=SMALLEST, le=1e15, description="Of the error.")

    def demand(self, scene: DemandContext) -> Demand:
        """Return the demand."""
        return trade_off_demand(
            scene.area_m2, self.localisation_m2, self.coverage_weight, self.localisation_weight
        )


DemandTable = Annotated[
    NumberTable | TableDemandTable | CapTable | AccuracyTable | TradeOffTable,
    Field(discriminator="kind"),
]
