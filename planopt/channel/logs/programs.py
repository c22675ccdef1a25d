"""Declarations of the logs that known programs write."""

from dataclasses import replace

from planopt.channel.logs.bag_table import COLUMNS
from planopt.channel.logs.readers import LogReader

WIGLE = LogReader(
    summary="WiGLE WiFi Wardriving (Android), CSV 1.4 to 1.6: Wi-Fi, Bluetooth and cells",
    signature=("MAC", "SSID", "AuthMode", "FirstSeen", "RSSI", "CurrentLatitude"),
    x="CurrentLongitude",
    y="CurrentLatitude",
    power="RSSI",
    transmitter="MAC",
    time="FirstSeen",
    accuracy="AccuracyMeters",
    preamble="WigleWifi-",
    no_power=("0",),
)
CELLMAPPER = LogReader(
    summary="CellMapper (Android), CSV of the serving cell",
    signature=("latitude", "longitude", "altitude", "MCC", "MNC", "LAC", "CID", "signal"),
    x="longitude",
    y="latitude",
    power="signal",
    transmitter="CID",
    no_power=("0",),
)
SURVEYED = ("deviceTime", "latitude", "longitude", "missionId", "recordNumber")


def _surveyed(technology: str, own: tuple[str, ...], power: str, transmitter: str) -> LogReader:
    return LogReader(
        summary=f"Network Survey (Android), CSV of {technology}",
        signature=(*SURVEYED, *own, power, transmitter),
        x="longitude",
        y="latitude",
        power=power,
        transmitter=transmitter,
        time="deviceTime",
        accuracy="accuracy",
    )


GSM = _surveyed("GSM", ("arfcn", "bsic"), "signalStrength", "ci")
UMTS = _surveyed("UMTS", ("uarfcn", "psc"), "rscp", "cid")
LTE = _surveyed("LTE", ("earfcn", "pci"), "rsrp", "eci")
NR = _surveyed("5G NR", ("narfcn", "pci"), "ssRsrp", "nci")
WIFI = _surveyed("Wi-Fi", ("ssid", "frequencyMhz"), "signalStrength", "bssid")
BLUETOOTH = _surveyed("Bluetooth", ("technology", "txPower"), "signalStrength", "sourceAddress")

MOVING = (
    "positions are those of the receiver; if the sender moved, give --columns "
    'x="sender long",y="sender lat"'
)

SNR_WORDS = (
    "rx snr is a signal-to-noise ratio in dB, not a power: thresholds are SNR too, and strong "
    "signals saturate near 10 dB"
)


def _range_test(power: str, words: str, remark: str) -> LogReader:
    return LogReader(
        summary=f"Meshtastic range test, rangetest.csv {words}",
        signature=("sender name", "sender lat", "sender long", "rx lat", "rx long", power),
        x="rx long",
        y="rx lat",
        power=power,
        transmitter="from",
        remark=remark,
    )


SNR = _range_test("rx snr", "with the SNR", f"{SNR_WORDS}; {MOVING}")
RSSI = _range_test("rx rssi", "with the RSSI", MOVING)
WIFI_LOGGER = LogReader(
    summary="wifi_logger_visualizer (ROS 2), SQLite table wifi_data, positions by odometry",
    signature=("timestamp", "x", "y", "bit_rate", "link_quality", "signal_level"),
    x="x",
    y="y",
    power="signal_level",
    in_degrees=False,
    time="timestamp",
)
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
