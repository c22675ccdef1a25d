"""planopt: motion plans for robots that must stay in radio contact.

Names are imported when they are first used, so that ``import planopt`` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from planopt.channel.belief import Belief
    from planopt.channel.connection.first_passage import FirstPassage, first_passage
    from planopt.channel.connection.joint_connectivity import JointConnectivity, joint_connectivity
    from planopt.channel.connection.outage import (
        DeliveredData,
        LongestOutage,
        delivered_data,
        longest_outage,
    )
    from planopt.channel.connection.several_stations import (
        SharedShadowing,
        connected_to_any,
        strongest_station,
    )
    from planopt.channel.connection.traffic import Traffic
    from planopt.channel.estimation.channel_fit import ChannelFit
    from planopt.channel.estimation.fit import fit_channel
    from planopt.channel.estimation.profile_likelihood import profile_likelihood
    from planopt.channel.fields.conditional_field import conditional_field
    from planopt.channel.fields.field import shadow_field_db
    from planopt.channel.fields.scattered_field import scattered_field_db
    from planopt.channel.fields.truth import (
        Truth,
        measure,
        model_truth,
        raster_truth,
        true_power_dbm,
    )
    from planopt.channel.joint import JointPrediction, joint_prediction, sample_power
    from planopt.channel.logs.log_file import read_log
    from planopt.channel.logs.log_format import LogFormat
    from planopt.channel.maps.cached_map import CachedMap
    from planopt.channel.maps.posterior_map import PosteriorMap, posterior_map
    from planopt.channel.measurements import Measurements
    from planopt.channel.multipath.multipath_connectivity import multipath_connectivity
    from planopt.channel.multipath.multipath_field import multipath_of
    from planopt.channel.multipath.multipath_models import Lognormal, Nakagami, Rician
    from planopt.channel.parameter_uncertainty import MarginalPosterior, marginalise
    from planopt.channel.parameters import ChannelParameters, Station
    from planopt.channel.path_loss_estimate import estimate_theta
    from planopt.channel.posterior import ChannelPosterior, at_time, condition
    from planopt.channel.posterior_derivatives import posterior_derivatives
    from planopt.channel.prediction import Prediction
    from planopt.channel.readings import predict_readings
    from planopt.channel.receiver_offsets import receiver_offsets
    from planopt.channel.sensitivity import mean_squared_error_db2, sensitivity_curves
    from planopt.channel.station.station_search import fit_channel_and_station
    from planopt.channel.validation.calibration import Calibration, calibrate
    from planopt.channel.validation.held_out_report import (
        HeldOutReport,
        held_out_report,
        predictors_of,
    )
    from planopt.errors import InputError, NoPlanError, OutputError, PlanoptError
    from planopt.planning.check.check import check
    from planopt.planning.explain.explain import explain, explain_no_plan
    from planopt.planning.loop.closed_loop import simulate
    from planopt.planning.plan import Termination, Verdict
    from planopt.planning.run import Run
    from planopt.planning.solution import Solution
    from planopt.planning.solve import solve
    from planopt.problems.casadi_term import casadi_term
    from planopt.problems.library import list_problems
    from planopt.problems.load import load
    from planopt.problems.problem import Problem
    from planopt.studies.compare import compare_horizons

__all__ = [
    "Belief",
    "CachedMap",
    "Calibration",
    "ChannelFit",
    "ChannelParameters",
    "ChannelPosterior",
    "DeliveredData",
    "FirstPassage",
    "HeldOutReport",
    "InputError",
    "JointConnectivity",
    "JointPrediction",
    "LogFormat",
    "Lognormal",
    "LongestOutage",
    "MarginalPosterior",
    "Measurements",
    "Nakagami",
    "NoPlanError",
    "OutputError",
    "PlanoptError",
    "PosteriorMap",
    "Prediction",
    "Problem",
    "Rician",
    "Run",
    "SharedShadowing",
    "Solution",
    "Station",
    "Termination",
    "Traffic",
    "Truth",
    "Verdict",
    "at_time",
    "calibrate",
    "casadi_term",
    "check",
    "compare_horizons",
    "condition",
    "conditional_field",
    "connected_to_any",
    "delivered_data",
    "estimate_theta",
    "explain",
    "explain_no_plan",
    "first_passage",
    "fit_channel",
    "fit_channel_and_station",
    "held_out_report",
    "joint_connectivity",
    "joint_prediction",
    "list_problems",
    "load",
    "longest_outage",
    "marginalise",
    "mean_squared_error_db2",
    "measure",
    "model_truth",
    "multipath_connectivity",
    "multipath_of",
    "posterior_derivatives",
    "posterior_map",
    "predict_readings",
    "predictors_of",
    "profile_likelihood",
    "raster_truth",
    "read_log",
    "receiver_offsets",
    "sample_power",
    "scattered_field_db",
    "sensitivity_curves",
    "shadow_field_db",
    "simulate",
    "solve",
    "strongest_station",
    "true_power_dbm",
]

_MODULES = {
    "Belief": "planopt.channel.belief",
    "CachedMap": "planopt.channel.maps.cached_map",
    "Calibration": "planopt.channel.validation.calibration",
    "ChannelFit": "planopt.channel.estimation.channel_fit",
    "ChannelParameters": "planopt.channel.parameters",
    "ChannelPosterior": "planopt.channel.posterior",
    "DeliveredData": "planopt.channel.connection.outage",
    "FirstPassage": "planopt.channel.connection.first_passage",
    "HeldOutReport": "planopt.channel.validation.held_out_report",
    "InputError": "planopt.errors",
    "JointConnectivity": "planopt.channel.connection.joint_connectivity",
    "JointPrediction": "planopt.channel.joint",
    "LogFormat": "planopt.channel.logs.log_format",
    "Lognormal": "planopt.channel.multipath.multipath_models",
    "LongestOutage": "planopt.channel.connection.outage",
    "MarginalPosterior": "planopt.channel.parameter_uncertainty",
    "Measurements": "planopt.channel.measurements",
    "Nakagami": "planopt.channel.multipath.multipath_models",
    "NoPlanError": "planopt.errors",
    "OutputError": "planopt.errors",
    "PlanoptError": "planopt.errors",
    "PosteriorMap": "planopt.channel.maps.posterior_map",
    "Prediction": "planopt.channel.prediction",
    "Problem": "planopt.problems.problem",
    "Rician": "planopt.channel.multipath.multipath_models",
    "Run": "planopt.planning.run",
    "SharedShadowing": "planopt.channel.connection.several_stations",
    "Solution": "planopt.planning.solution",
    "Station": "planopt.channel.parameters",
    "Termination": "planopt.planning.plan",
    "Traffic": "planopt.channel.connection.traffic",
    "Truth": "planopt.channel.fields.truth",
    "Verdict": "planopt.planning.plan",
    "at_time": "planopt.channel.posterior",
    "calibrate": "planopt.channel.validation.calibration",
    "casadi_term": "planopt.problems.casadi_term",
    "check": "planopt.planning.check.check",
    "compare_horizons": "planopt.studies.compare",
    "condition": "planopt.channel.posterior",
    "conditional_field": "planopt.channel.fields.conditional_field",
    "connected_to_any": "planopt.channel.connection.several_stations",
    "delivered_data": "planopt.channel.connection.outage",
    "estimate_theta": "planopt.channel.path_loss_estimate",
    "explain": "planopt.planning.explain.explain",
    "explain_no_plan": "planopt.planning.explain.explain",
    "first_passage": "planopt.channel.connection.first_passage",
    "fit_channel": "planopt.channel.estimation.fit",
    "fit_channel_and_station": "planopt.channel.station.station_search",
    "held_out_report": "planopt.channel.validation.held_out_report",
    "joint_connectivity": "planopt.channel.connection.joint_connectivity",
    "joint_prediction": "planopt.channel.joint",
    "list_problems": "planopt.problems.library",
    "load": "planopt.problems.load",
    "longest_outage": "planopt.channel.connection.outage",
    "marginalise": "planopt.channel.parameter_uncertainty",
    "mean_squared_error_db2": "planopt.channel.sensitivity",
    "measure": "planopt.channel.fields.truth",
    "model_truth": "planopt.channel.fields.truth",
    "multipath_connectivity": "planopt.channel.multipath.multipath_connectivity",
    "multipath_of": "planopt.channel.multipath.multipath_field",
    "posterior_derivatives": "planopt.channel.posterior_derivatives",
    "posterior_map": "planopt.channel.maps.posterior_map",
    "predict_readings": "planopt.channel.readings",
    "predictors_of": "planopt.channel.validation.held_out_report",
    "profile_likelihood": "planopt.channel.estimation.profile_likelihood",
    "raster_truth": "planopt.channel.fields.truth",
    "read_log": "planopt.channel.logs.log_file",
    "receiver_offsets": "planopt.channel.receiver_offsets",
    "sample_power": "planopt.channel.joint",
    "scattered_field_db": "planopt.channel.fields.scattered_field",
    "sensitivity_curves": "planopt.channel.sensitivity",
    "shadow_field_db": "planopt.channel.fields.field",
    "simulate": "planopt.planning.loop.closed_loop",
    "solve": "planopt.planning.solve",
    "strongest_station": "planopt.channel.connection.several_stations",
    "true_power_dbm": "planopt.channel.fields.truth",
}
"""Where each public name stands."""

_FORMER = {"Simulation": "Run", "TeamRun": "Run", "TeamSolution": "Solution"}
"""Former public names, accepted for one version, and the names that replace them."""


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name in _FORMER:
        return _replacement(name)
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def _replacement(name: str) -> Any:
    from warnings import warn

    new = _FORMER[name]
    warn(f"planopt.{name} is now planopt.{new}", DeprecationWarning, stacklevel=3)
    return getattr(import_module(_MODULES[new]), new)


def __dir__() -> list[str]:
    """The public names, for completion."""
    return sorted({*globals(), *__all__})
