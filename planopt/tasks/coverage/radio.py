"""``[radio]`` of the task coverage: base stations, laws of links, and surveys of their power."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planopt.channel import (
    ChannelParameters,
    ChannelPosterior,
    LogFormat,
    Measurements,
    Station,
    condition,
    fit_channel,
    measure,
    model_truth,
    read_log,
)
from planopt.coverage.geodesic import Ground
from planopt.coverage.limits import LinkLaw, RadioLimits, StationMap, station_map
from planopt.errors import InputError
from planopt.keys import FileName, Metres, Pair, Table

CELLS = 8
"""Cells of a drawn channel within the distance over which its shadowing forgets."""

MOST_CELLS = 1_000_000
"""A drawn channel has at most so many cells."""


class SurveyTable(Table):
    """``[[radio.survey]]``: measured power from a station, from a log, in place, or simulated."""

    file: FileName | None = Field(
        default=None, description="CSV with x_m, y_m and power_dbm, relative to the problem file."
    )
    places_m: list[Pair] | None = Field(
        default=None, min_length=1, description="In place: where, [x, y]."
    )
    power_dbm: list[float] | None = Field(default=None, description="In place: the powers in dBm.")
    floor_dbm: float | None = Field(
        default=None, ge=-500, le=300, description="Powers at or below it are upper limits."
    )
    count: int | None = Field(
        default=None,
        ge=10,
        le=2000,
        description="Simulated: measured at so many random places, of a channel drawn with "
        "radio.k_pl_db, radio.n_pl and the shadowing below.",
    )
    shadow_std_db: float = Field(default=6.0, ge=0, le=50, description="Simulated: shadowing.")
    decorrelation_m: Metres = Field(default=25.0, ge=0.1, description="Simulated: it forgets so.")
    multipath_std_db: float = Field(default=1.0, ge=0, le=50, description="Simulated: multipath.")
    seed: int = Field(default=0, ge=0, le=2**63 - 1, description="Simulated: the random seed.")

    @model_validator(mode="after")
    def _one_source(self) -> SurveyTable:
        in_place = self.places_m is not None or self.power_dbm is not None
        if sum((self.file is not None, in_place, self.count is not None)) != 1:
            raise PydanticCustomError(
                "one_of", "needs exactly one of file, places_m with power_dbm, and count"
            )
        if in_place and len(self.places_m or ()) != len(self.power_dbm or ()):
            raise PydanticCustomError("lengths", "has not one power for each place")
        return self

    def measurements(
        self, radio: RadioTable, station: Station, ground: Ground, folder: Path
    ) -> Measurements:
        """Return what was measured; simulated surveys are drawn from the seed."""
        if self.file is not None:
            return read_log(folder / self.file, LogFormat(floor_dbm=self.floor_dbm))
        if self.places_m is not None and self.power_dbm is not None:
            power, floor = np.array(self.power_dbm), self.floor_dbm
            censored = np.zeros(len(power), dtype=np.bool_) if floor is None else power <= floor
            return Measurements(np.array(self.places_m), power, censored)
        assert self.count is not None
        generator = np.random.default_rng(self.seed)
        low, high = ground.hull.corners_m.min(axis=0), ground.hull.corners_m.max(axis=0)
        cell_m = self.decorrelation_m / CELLS
        if np.prod((high - low) / cell_m) > MOST_CELLS:
            raise InputError(
                f"gives more than {MOST_CELLS} cells", key="decorrelation_m",
                remedy="give a larger one",
            )  # fmt: skip
        truth = model_truth(
            ChannelParameters(
                radio.k_pl_db,
                radio.n_pl,
                self.shadow_std_db,
                self.decorrelation_m,
                self.multipath_std_db,
                station,
            ),
            (float(low[0]), float(low[1]), float(high[0]), float(high[1])),
            cell_m,
            self.floor_dbm,
            generator,
        )
        places = low + (high - low) * generator.random((40 * self.count, 2))
        free = places[ground.allows(places)][: self.count]
        if len(free) < self.count:
            raise InputError(
                f"only {len(free)} of {self.count} places are free", key="count",
                remedy="ask for fewer",
            )  # fmt: skip
        return measure(truth, free)


class RadioTable(Table):
    """``[radio]``: links to base stations that agents keep, directly or over other agents."""

    stations_m: list[Pair] = Field(min_length=1, max_length=100, description="Base stations.")
    p_min: float = Field(
        gt=0, lt=1, description="Each agent keeps its way to a station with this probability."
    )
    k_pl_db: float = Field(ge=-300, le=300, description="Received power at 1 m in dBm.")
    n_pl: float = Field(ge=0.1, le=10, description="Path loss exponent.")
    deviation_db: float = Field(
        ge=0, le=100, description="Standard deviation of shadowing and multipath together."
    )
    k_pl_std_db: float = Field(default=0.0, ge=0, le=100, description="How uncertain k_pl_db is.")
    n_pl_std: float = Field(default=0.0, ge=0, le=10, description="How uncertain n_pl is.")
    threshold_dbm: float = Field(ge=-500, le=300, description="Power that a link needs.")
    survey: list[SurveyTable] = Field(
        default=[],
        description="For each station what was measured of it: links to stations are those of the "
        "channel that is learnt from it, links between agents keep to the law above.",
    )

    def station_map(self, ground: Ground, folder: Path) -> StationMap | None:
        """Return the map that is learnt from the surveys; None without any."""
        if not self.survey:
            return None
        if len(self.survey) != len(self.stations_m):
            raise InputError(
                f"has {len(self.survey)} entries for {len(self.stations_m)} stations",
                key="radio.survey",
                remedy="give one for each station, in their order",
            )
        posteriors: list[ChannelPosterior] = []
        for number, (table, place) in enumerate(zip(self.survey, self.stations_m, strict=True)):
            station = Station(place)
            try:
                measured = table.measurements(self, station, ground, folder)
                fit = fit_channel(measured, station)
                posteriors.append(condition(fit.parameters, measured))
            except InputError as error:
                key = f"radio.survey[{number}]" + (f".{error.key}" if error.key else "")
                raise InputError(
                    error.message, file=error.file, key=key, row=error.row, remedy=error.remedy
                ) from error
        low, high = ground.hull.corners_m.min(axis=0), ground.hull.corners_m.max(axis=0)
        bounds = float(low[0]), float(low[1]), float(high[0]), float(high[1])
        return station_map(posteriors, self.threshold_dbm, bounds)

    def limits(self, mapped: StationMap | None) -> RadioLimits:
        """Return the links that agents keep."""
        spread = np.diag([self.k_pl_std_db**2, self.n_pl_std**2])
        law = LinkLaw(np.array([self.k_pl_db, self.n_pl]), self.deviation_db, spread)
        stations = np.array(self.stations_m)
        return RadioLimits(stations, mapped or law, law, self.threshold_dbm, self.p_min)
