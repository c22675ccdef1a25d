"""Recordings of robots (rosbag2, MCAP), as joined by :mod:`planopt.channel.logs.bag_table`."""

from dataclasses import replace

from planopt.channel.logs.bag_table import COLUMNS
from planopt.channel.logs.readers import LogReader

METRES = LogReader(
    summary="rosbag2 (SQLite, MCAP) and MCAP, positions by TF, poses or odometry",
    signature=(*COLUMNS, "x", "y"),
    x="x",
    y="y",
    power="power_dbm",
    in_degrees=False,
    transmitter="transmitter",
    time="stamp_s",
)
DEGREES = replace(
    METRES,
    summary="rosbag2 (SQLite, MCAP) and MCAP, positions by GPS",
    signature=(*COLUMNS, "longitude", "latitude"),
    x="longitude",
    y="latitude",
    in_degrees=True,
)
