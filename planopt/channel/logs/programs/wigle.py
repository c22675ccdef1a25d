"""WiGLE WiFi Wardriving: CSV of all networks seen, version 1.4 to 1.6."""

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
