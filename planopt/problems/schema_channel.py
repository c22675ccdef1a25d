"""The table ``[channel]`` of a problem file: truth, first measurements and fit."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planopt.channel.estimation.channel_fit import FitMethod
from planopt.channel.fields.multipath import Multipath, MultipathKind, multipath_of
from planopt.errors import InputError
from planopt.problems.channel_setup import (
    ChannelSetup,
    GivenParameters,
    LoggedMeasurements,
    RasterTruth,
)
from planopt.problems.tables import Decibels, FileName, Table, TableOf

MIN_DEVIATION_DB = 0.001
"""Weaker fading is none; m and K grow with the inverse square of its deviation."""


class MultipathTable(Table):
    """``multipath``: a kind, and exactly one of m, k and std_db (none for rayleigh)."""

    kind: MultipathKind = Field(description="nakagami, rician, rayleigh or lognormal.")
    m: float | None = Field(
        default=None, ge=0.5, le=1e8, description="Nakagami's m (a number, at least 1 for rician)."
    )
    k: float | None = Field(default=None, ge=0, le=1e8, description="Rician K (linear ratio).")
    std_db: float | None = Field(
        default=None, ge=0, le=100, description="omega, deviation of multipath in dB."
    )

    @property
    def law(self) -> Multipath:
        """The multipath in its own number."""
        return multipath_of(self.kind, m=self.m, k=self.k, std_db=self.std_db)

    @model_validator(mode="after")
    def _exists(self) -> MultipathTable:
        try:
            deviation = self.law.std_db
        except InputError as error:
            words = error.message if error.remedy is None else f"{error.message}: {error.remedy}"
            raise PydanticCustomError("one_of", "{words}", {"words": words}) from error
        # Whatever number it was given by, its own one can then be saved.
        if deviation < MIN_DEVIATION_DB and self.kind != "lognormal":
            raise PydanticCustomError(
                "one_of",
                "is fading of less than {least} dB: leave multipath out, or give more",
                {"least": MIN_DEVIATION_DB},
            )
        return self


class RasterTruthTable(Table):
    """``[channel.truth]`` with ``kind = "raster"``: a map of path gains."""

    kind: Literal["raster"] = Field(description="A map of path gains from a file.")
    file: FileName = Field(
        description="npz (x, y and the variable on [iy, ix], or a radio map of Sionna RT), CSV, "
        "NetCDF or GeoTIFF, by ending; relative to the problem file."
    )
    variable: str = Field(
        default=RasterTruth.variable, min_length=1, description="Name of the path gain in dB."
    )
    quantity: Literal["gain", "power"] = Field(
        default=RasterTruth.quantity,
        description="gain (path gain in dB, to which transmit_power_dbm is added) or power "
        "(received power in dBm, such as mean_db of planopt map).",
    )
    floor_db: Decibels = Field(
        description="The receiver's floor as a path gain in dB: what is below is clipped and "
        "censored."
    )
    rician_k: float | None = Field(
        default=None,
        gt=0,
        le=1e8,
        description="Rician K factor (linear ratio) of small-scale fading; left out: no fading.",
    )
    multipath: MultipathTable | None = Field(
        default=None, description="Small-scale fading of another kind than rician_k gives."
    )

    @model_validator(mode="after")
    def _one_fading(self) -> RasterTruthTable:
        if self.rician_k is not None and self.multipath is not None:
            raise PydanticCustomError(
                "one_of", "has rician_k and multipath, one is enough: leave rician_k out"
            )
        return self


class ModelTruthTable(Table):
    """``[channel.truth]`` with ``kind = "model"``: drawn from the channel model."""

    kind: Literal["model"] = Field(
        description="Drawn from the channel model, with the random seed."
    )
    k_pl_db: Decibels = Field(description="K_PL as a path gain at one metre, in dB.")
    n_pl: float = Field(gt=0, le=20, description="n_PL, path loss exponent (a number).")
    shadow_std_db: float = Field(ge=0, le=100, description="xi, deviation of shadowing in dB.")
    decorrelation_m: float = Field(
        gt=0, le=1e6, description="beta, decorrelation distance of shadowing in metres."
    )
    multipath_std_db: float | None = Field(
        default=None,
        ge=0,
        le=100,
        description="omega, deviation in dB of multipath that is Gaussian in dB.",
    )
    multipath: MultipathTable | None = Field(
        default=None, description="Multipath of another kind, in place of multipath_std_db."
    )
    cell_m: float = Field(gt=0, le=1e6, description="Cell side of the drawn map in metres.")
    floor_db: Decibels | None = Field(
        default=None,
        description="The receiver's floor as a path gain in dB; left out: no floor.",
    )

    @model_validator(mode="after")
    def _one_multipath(self) -> ModelTruthTable:
        if (self.multipath_std_db is None) == (self.multipath is None):
            raise PydanticCustomError(
                "one_of",
                "needs exactly one of multipath_std_db and multipath, has {given}: write "
                "multipath_std_db = 3.0, for instance",
                {"given": "none" if self.multipath is None else "both"},
            )
        return self


class FittedTruthTable(Table):
    """``[channel.truth]`` with ``kind = "fitted"``: drawn from the posterior of a log."""

    kind: Literal["fitted"] = Field(
        description="Drawn with the random seed from the channel fitted to the log of first "
        "measurements."
    )
    cell_m: float = Field(gt=0, le=1e6, description="Cell side of the drawn map in metres.")
    floor_db: Decibels | None = Field(
        default=None,
        description="The receiver's floor as a path gain in dB; left out: no floor.",
    )


TruthTable = RasterTruthTable | ModelTruthTable | FittedTruthTable


class ColumnsTable(Table):
    """``columns`` of a log: what its columns are called."""

    x: str = Field(
        default=LoggedMeasurements.columns[0], min_length=1, description="Column of x in metres."
    )
    y: str = Field(
        default=LoggedMeasurements.columns[1], min_length=1, description="Column of y in metres."
    )
    power: str = Field(
        default=LoggedMeasurements.columns[2],
        min_length=1,
        description="Column of received power in dBm.",
    )


class MeasurementsTable(Table):
    """``[channel.measurements]``: exactly one of ``count`` and ``file``."""

    count: int | None = Field(
        default=None,
        ge=0,
        le=100_000,
        description="Number of first measurements, taken from the truth at seeded free places; 0 "
        "where fit.given has path loss too, or in saved results, of first measurements that were "
        "given in Python.",
    )
    file: FileName | None = Field(
        default=None, description="CSV log of first measurements, relative to the problem file."
    )
    columns: ColumnsTable | None = Field(
        default=None, description="Column names of the log, if not x_m, y_m and power_dbm."
    )
    censored_column: str | None = Field(
        default=None, min_length=1, description="Column of the log that marks censored rows."
    )
    floor_dbm: Decibels | None = Field(
        default=None, description="Powers in the log at or below this many dBm are censored."
    )
    spacing_m: float = Field(
        default=ChannelSetup.measure_spacing_m,
        ge=0,
        le=1e6,
        description="On the way a robot measures only at this distance in metres from every "
        "earlier measurement.",
    )
    shared: bool = Field(
        default=ChannelSetup.share_measurements,
        description="Whether every robot has the measurements of all robots after each step (true "
        "or false).",
    )

    @model_validator(mode="after")
    def _one_source(self) -> MeasurementsTable:
        if (self.count is None) == (self.file is None):
            raise PydanticCustomError(
                "one_of",
                "needs exactly one of count and file, has {given}: write count = 100, or "
                'file = "log.csv"',
                {"given": "none" if self.count is None else "count and file"},
            )
        for key in ("columns", "censored_column", "floor_dbm"):
            if self.file is None and getattr(self, key) is not None:
                raise PydanticCustomError(
                    "one_of",
                    "has {given}, which goes only with file: leave it out",
                    {"given": key},
                )
        return self


class FitTable(Table):
    """``[channel.fit]``: how parameters are estimated."""

    method: FitMethod = Field(
        default=ChannelSetup.fit_method,
        description="lemma1, capped, convex, nls or reml: docs/channel.md, Fit.",
    )
    given: Annotated[GivenParameters, TableOf(GivenParameters, "GivenTable")] | None = Field(
        default=None,
        description="Parameters that are known and not estimated: shadow_std_db, decorrelation_m "
        "and multipath_std_db, and k_pl_db and n_pl or neither.",
    )


class ChannelTable(Table):
    """``[channel]``: how power varies and what is known of it."""

    truth: Annotated[TruthTable, Field(discriminator="kind")] | None = Field(
        default=None, description="The true channel, for simulation; may be left out."
    )
    measurements: MeasurementsTable
    fit: FitTable = Field(default_factory=FitTable)
