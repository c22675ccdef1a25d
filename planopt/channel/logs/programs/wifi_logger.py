"""wifi_logger_visualizer (ROS 2): SQLite table wifi_data."""

from planopt.channel.logs.readers import LogReader

WIFI_LOGGER = LogReader(
    summary="wifi_logger_visualizer (ROS 2), SQLite table wifi_data, positions by odometry",
    signature=("timestamp", "x", "y", "bit_rate", "link_quality", "signal_level"),
    x="x",
    y="y",
    power="signal_level",
    in_degrees=False,
    time="timestamp",
)
