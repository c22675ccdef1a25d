"""Public names of the radio channel; each is imported from its module when it is first used."""

from planopt.channel.channel_map import PosteriorMap as PosteriorMap
from planopt.channel.channel_map import posterior_map as posterior_map
from planopt.channel.channel_map import serving_map as serving_map
from planopt.channel.connectivity_law import connected_to_any as connected_to_any
from planopt.channel.estimation.channel_fit import ChannelFit as ChannelFit
from planopt.channel.estimation.fit import fit_channel as fit_channel
from planopt.channel.estimation.station_fit import (
    fit_channel_and_station as fit_channel_and_station,
)
from planopt.channel.ground_truth import Lognormal as Lognormal
from planopt.channel.ground_truth import Nakagami as Nakagami
from planopt.channel.ground_truth import Rician as Rician
from planopt.channel.ground_truth import Truth as Truth
from planopt.channel.ground_truth import measure as measure
from planopt.channel.ground_truth import model_truth as model_truth
from planopt.channel.ground_truth import multipath_of as multipath_of
from planopt.channel.ground_truth import raster_truth as raster_truth
from planopt.channel.ground_truth import true_power_dbm as true_power_dbm
from planopt.channel.held_out import HeldOutReport as HeldOutReport
from planopt.channel.held_out import held_out_report as held_out_report
from planopt.channel.held_out import predictors_of as predictors_of
from planopt.channel.joint import DeliveredData as DeliveredData
from planopt.channel.joint import JointPrediction as JointPrediction
from planopt.channel.joint import LongestOutage as LongestOutage
from planopt.channel.joint import Traffic as Traffic
from planopt.channel.joint import delivered_data as delivered_data
from planopt.channel.joint import joint_prediction as joint_prediction
from planopt.channel.joint import longest_outage as longest_outage
from planopt.channel.joint import predict_readings as predict_readings
from planopt.channel.joint import sample_power as sample_power
from planopt.channel.kriging import Prediction as Prediction
from planopt.channel.logs.log_format import LogFormat as LogFormat
from planopt.channel.logs.power_log import read_log as read_log
from planopt.channel.long_logs import receiver_offsets as receiver_offsets
from planopt.channel.measurements import Measurements as Measurements
from planopt.channel.parameter_uncertainty import MarginalPosterior as MarginalPosterior
from planopt.channel.parameter_uncertainty import marginalise as marginalise
from planopt.channel.parameter_uncertainty import mean_squared_error_db2 as mean_squared_error_db2
from planopt.channel.parameter_uncertainty import sensitivity_curves as sensitivity_curves
from planopt.channel.parameters import ChannelParameters as ChannelParameters
from planopt.channel.parameters import Station as Station
from planopt.channel.path_connectivity import FirstPassage as FirstPassage
from planopt.channel.path_connectivity import JointConnectivity as JointConnectivity
from planopt.channel.path_connectivity import first_passage as first_passage
from planopt.channel.path_connectivity import joint_connectivity as joint_connectivity
from planopt.channel.posterior import Belief as Belief
from planopt.channel.posterior import ChannelPosterior as ChannelPosterior
from planopt.channel.posterior import at_time as at_time
from planopt.channel.posterior import condition as condition
from planopt.channel.shadow_fields import conditional_field as conditional_field
from planopt.channel.shadow_fields import scattered_field_db as scattered_field_db
from planopt.channel.shadow_fields import shadow_field_db as shadow_field_db
