"""Public names of the radio channel; each is imported from its module when it is first used."""

from planopt.channel.belief import Belief as Belief
from planopt.channel.calibration import Calibration as Calibration
from planopt.channel.calibration import HeldOutReport as HeldOutReport
from planopt.channel.calibration import calibrate as calibrate
from planopt.channel.calibration import held_out_report as held_out_report
from planopt.channel.channel_map import PosteriorMap as PosteriorMap
from planopt.channel.channel_map import posterior_map as posterior_map
from planopt.channel.connection.first_passage import FirstPassage as FirstPassage
from planopt.channel.connection.first_passage import first_passage as first_passage
from planopt.channel.connection.joint_connectivity import JointConnectivity as JointConnectivity
from planopt.channel.connection.joint_connectivity import joint_connectivity as joint_connectivity
from planopt.channel.connection.law import connected_to_any as connected_to_any
from planopt.channel.connection.outage import DeliveredData as DeliveredData
from planopt.channel.connection.outage import LongestOutage as LongestOutage
from planopt.channel.connection.outage import Traffic as Traffic
from planopt.channel.connection.outage import delivered_data as delivered_data
from planopt.channel.connection.outage import longest_outage as longest_outage
from planopt.channel.derivatives import posterior_derivatives as posterior_derivatives
from planopt.channel.estimation.channel_fit import ChannelFit as ChannelFit
from planopt.channel.estimation.fit import fit_channel as fit_channel
from planopt.channel.estimation.station_fit import (
    fit_channel_and_station as fit_channel_and_station,
)
from planopt.channel.fields.field import conditional_field as conditional_field
from planopt.channel.fields.field import scattered_field_db as scattered_field_db
from planopt.channel.fields.field import shadow_field_db as shadow_field_db
from planopt.channel.fields.multipath import Lognormal as Lognormal
from planopt.channel.fields.multipath import Nakagami as Nakagami
from planopt.channel.fields.multipath import Rician as Rician
from planopt.channel.fields.multipath import multipath_of as multipath_of
from planopt.channel.fields.truth import Truth as Truth
from planopt.channel.fields.truth import measure as measure
from planopt.channel.fields.truth import model_truth as model_truth
from planopt.channel.fields.truth import raster_truth as raster_truth
from planopt.channel.fields.truth import true_power_dbm as true_power_dbm
from planopt.channel.held_out import predictors_of as predictors_of
from planopt.channel.joint import JointPrediction as JointPrediction
from planopt.channel.joint import joint_prediction as joint_prediction
from planopt.channel.joint import predict_readings as predict_readings
from planopt.channel.joint import sample_power as sample_power
from planopt.channel.measurements import Measurements as Measurements
from planopt.channel.offsets import receiver_offsets as receiver_offsets
from planopt.channel.parameter_uncertainty import MarginalPosterior as MarginalPosterior
from planopt.channel.parameter_uncertainty import marginalise as marginalise
from planopt.channel.parameters import ChannelParameters as ChannelParameters
from planopt.channel.parameters import Station as Station
from planopt.channel.posterior import ChannelPosterior as ChannelPosterior
from planopt.channel.posterior import at_time as at_time
from planopt.channel.posterior import condition as condition
from planopt.channel.posterior import estimate_theta as estimate_theta
from planopt.channel.power_log import LogFormat as LogFormat
from planopt.channel.power_log import read_log as read_log
from planopt.channel.prediction import Prediction as Prediction
from planopt.channel.sensitivity import mean_squared_error_db2 as mean_squared_error_db2
from planopt.channel.sensitivity import sensitivity_curves as sensitivity_curves
